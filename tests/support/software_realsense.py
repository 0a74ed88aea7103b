"""A RealSense of librealsense's own software: its streams, options and pipeline are the real ones, without hardware.

`rs.context` is replaced by one that has these devices: `software_device.add_to` keeps no hold of them in Python.
"""

import threading

import numpy as np

WIDTH, HEIGHT, FPS = 64, 48, 30
SERIAL, ASIC_SERIAL = "218622274409", "841113021535"
MOST_EXPOSURE, DEFAULT_EXPOSURE = 165000, 33000  # µs, of a D405


class SoftwareRealSense:
    """A D405, whose stereo module gives colour and depth; with `rgb`, a D435, whose RGB camera gives the colour.

    Attributes:
        bright_at: exposure at which a picture is just fully white. Darker ones are in proportion.
    """

    def __init__(self, rs, serial=SERIAL, rgb=False, depth_unit_m=1e-4, bright_at=4000.0):
        self._rs, self.bright_at = rs, bright_at
        self.device = rs.software_device()
        for name, value in {
            "serial_number": serial,
            "asic_serial_number": ASIC_SERIAL,
            "name": f"Intel RealSense {'D435' if rgb else 'D405'}",
        }.items():
            self.device.register_info(getattr(rs.camera_info, name), value)
        self.stereo = self.device.add_sensor("Stereo Module")
        self.colour = self.device.add_sensor("RGB Camera") if rgb else self.stereo
        self._profiles = {
            "color": self.colour.add_video_stream(self._stream(rs.stream.color, 1, rs.format.rgb8, 3), True),
            "depth": self.stereo.add_video_stream(self._stream(rs.stream.depth, 2, rs.format.z16, 2), True),
        }
        self._add_option(self.colour, rs.option.exposure, 1, MOST_EXPOSURE, DEFAULT_EXPOSURE)
        self._add_option(self.colour, rs.option.gain, 16, 248, 16)
        self._add_option(self.colour, rs.option.enable_auto_exposure, 0, 1, 1)
        self._add_option(self.colour, rs.option.white_balance, 2800, 6500, 4600)
        self._add_option(self.colour, rs.option.enable_auto_white_balance, 0, 1, 1)
        self._depth_unit_m = depth_unit_m
        self.number = 0
        self.depth_m = 0.25
        self.stalls = False
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._feed)
        self._thread.start()

    def option(self, name):
        """What an option of the colour's module is set to."""
        return self.colour.get_option(getattr(self._rs.option, name))

    def close(self):
        """No more pictures; librealsense gives back what it has opened for the device."""
        self._ended.set()
        self._thread.join()
        del self.device, self.stereo, self.colour, self._profiles

    def _stream(self, kind, number, form, size):
        lens = self._rs.intrinsics()
        lens.width, lens.height, lens.ppx, lens.ppy, lens.fx, lens.fy = WIDTH, HEIGHT, WIDTH / 2, HEIGHT / 2, 50, 50
        stream = self._rs.video_stream()
        stream.type, stream.uid, stream.fmt, stream.bpp = kind, number, form, size
        stream.width, stream.height, stream.fps, stream.intrinsics = WIDTH, HEIGHT, FPS, lens
        return stream

    def _add_option(self, sensor, option, least, most, default):
        span = self._rs.option_range()
        span.min, span.max, span.step, span.default = least, most, 1, default
        sensor.add_option(option, span, True)

    def _feed(self):
        while not self._ended.wait(1 / FPS):
            if self.stalls:
                continue
            self.number += 1
            level = min(255, round(255 * self.option("exposure") / self.bright_at))
            colour = np.full((HEIGHT, WIDTH, 3), level, np.uint8)
            colour[:, WIDTH // 2 :] //= 2  # half of the picture reflects half as much
            depth = np.full((HEIGHT, WIDTH), round(self.depth_m / self._depth_unit_m), np.uint16)
            for name, picture, sensor in (("color", colour, self.colour), ("depth", depth, self.stereo)):
                frame = self._rs.software_video_frame()
                frame.pixels, frame.bpp = picture, picture[0, 0].nbytes
                frame.stride, frame.frame_number = WIDTH * frame.bpp, self.number
                frame.timestamp, frame.domain = 1e3 * self.number / FPS, self._rs.timestamp_domain.hardware_clock
                frame.profile = self._profiles[name].as_video_stream_profile()
                frame.depth_units = self._depth_unit_m
                sensor.on_video_frame(frame)


class Bus:
    """Stands where librealsense looks for cameras: `rs.context`."""

    def __init__(self):
        self.plugged = []

    def __call__(self):
        return self

    def query_devices(self):
        return [camera.device for camera in self.plugged]
