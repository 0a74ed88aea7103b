"""RealSense read with librealsense, colour and depth. On a D405 the colour comes from the stereo module."""

import time
from types import ModuleType
from typing import Any

import numpy as np

from lerobot_robot_yam.cameras.picture_source import Picture, Wanted
from lerobot_robot_yam.cameras.video_devices import VideoDevice, in_use
from lerobot_robot_yam.errors import CameraError, ConfigError
from lerobot_robot_yam.system.own_commands import install_extra

_POLL_MS = 200  # wait for an image before checking that the camera is still connected, ms
_SILENT_S = 1.0  # time without an image after which the camera counts as stalled and is reopened, s
_MM = 1e-3  # one millimetre, m
# Control of `Wanted` → librealsense option for automatic control.
_AUTOMATIC = {
    "exposure": "enable_auto_exposure",
    "gain": "enable_auto_exposure",
    "white_balance": "enable_auto_white_balance",
}
_BUSY = ("busy", "power state", "errno=16")  # words in librealsense's error if another program uses the camera


def library() -> ModuleType:
    """Import pyrealsense2. Raises CameraError: the module is not installed, or a system library is missing."""
    try:
        import pyrealsense2
    except ModuleNotFoundError as error:
        raise CameraError(
            f"pyrealsense2, the maker's library, is not installed; {install_extra('realsense')}"
        ) from error
    except ImportError as error:  # a library required by pyrealsense2 is missing
        raise CameraError(f"pyrealsense2 cannot be loaded ({error}): sudo apt install libusb-1.0-0") from error
    return pyrealsense2


def plugged_in() -> list[Any]:
    """List librealsense's devices; empty if pyrealsense2 cannot be imported."""
    try:
        rs = library()
    except CameraError:
        return []
    try:
        return list(rs.context().query_devices())
    except RuntimeError as error:
        raise CameraError(f"librealsense finds no cameras: {error}") from error


def info(device: Any, name: str) -> str | None:
    """Return an information string of a device, such as "serial_number"; None if the device does not provide it."""
    key = getattr(library().camera_info, name)
    return device.get_info(key) if device.supports(key) else None


def serials(device: Any) -> tuple[str | None, str | None]:
    """Return the serial number on the label, and the serial number of the USB device."""
    return info(device, "serial_number"), info(device, "asic_serial_number")


def modes_of(device: Any, kind: Any) -> list[tuple[int, int, int]]:
    """List width, height and rate of all streams of a kind (`stream.color`, `stream.depth`), in ascending order."""
    profiles = [p for sensor in device.query_sensors() for p in sensor.get_stream_profiles() if p.stream_type() == kind]
    videos = [p.as_video_stream_profile() for p in profiles]
    return sorted({(v.width(), v.height(), v.fps()) for v in videos})


class RealSenseSource:
    """Open RealSense: a `PictureSource` with simultaneous colour and depth.

    Args:
        device: a device returned by `plugged_in`.
        wanted: streams, size, rate and controls.
        seen: the same camera in sysfs; None if sysfs does not list the camera.

    Raises:
        ConfigError: the camera does not support a size, rate or value; the message lists the supported values.
        CameraError: the camera is in use, or access is denied.
    """

    def __init__(self, device: Any, wanted: Wanted, seen: VideoDevice | None = None):
        self._rs, self._device, self._wanted = library(), device, wanted
        self._name = f"{info(device, 'name')} {info(device, 'serial_number')}"
        rs = self._rs
        kinds = [(rs.stream.color, rs.format.rgb8)] if wanted.colour else []
        kinds += [(rs.stream.depth, rs.format.z16)] if wanted.depth else []
        streams = rs.config()
        for kind, form in kinds:
            if wanted.width is None:
                streams.enable_stream(kind)
                continue
            if (wanted.width, wanted.height, wanted.fps) not in (offered := modes_of(device, kind)):
                which = ", ".join(f"{width}x{height} at {fps}" for width, height, fps in offered)
                raise ConfigError(f"{self._name} does not offer {kind.name} {wanted.size}; it offers {which} fps")
            streams.enable_stream(kind, wanted.width, wanted.height, form, wanted.fps)
        for name in _AUTOMATIC:
            if (asked := getattr(wanted, name)) is not None:
                self.set_control(name, asked)
        self._pipeline = rs.pipeline()
        self._pipeline.set_device(device)
        try:
            self._pipeline.start(streams)
        except RuntimeError as error:
            raise CameraError(self._why(error, seen)) from error
        self._running = True

    def read(self) -> Picture:
        begin_s = time.monotonic()
        try:
            while True:
                there, frames = self._pipeline.try_wait_for_frames(_POLL_MS)
                if there:
                    return self._picture(frames)
                if not self._device.is_connected():
                    raise CameraError(f"{self._name} is gone: unplugged, or without power")
                if time.monotonic() - begin_s > _SILENT_S:
                    raise CameraError(f"{self._name} gives no picture")
        except RuntimeError as error:
            raise CameraError(f"{self._name}: {error}") from error

    def exposure_range(self) -> tuple[int, int]:
        span = self._sensor("exposure").get_option_range(self._rs.option.exposure)
        return int(span.min), int(span.max)

    def close(self) -> None:
        if self._running:
            self._running = False
            self._pipeline.stop()

    def _picture(self, frames: Any) -> Picture:
        stamp_s, colour, depth = time.monotonic(), None, None
        if self._wanted.colour:
            colour = np.array(frames.get_color_frame().get_data())
        if self._wanted.depth:
            frame = frames.get_depth_frame()
            depth, unit = np.array(frame.get_data())[..., np.newaxis], frame.get_units()
            if not np.isclose(unit, _MM):  # a D405 uses units of 0.1 mm
                depth = np.round(depth * (unit / _MM)).astype(np.uint16)
        return Picture(stamp_s, colour, depth)

    def _sensor(self, name: str) -> Any:
        """Return the module that provides colour. Raises CameraError: this module does not have option `name`."""
        colour = self._rs.stream.color
        for sensor in self._device.query_sensors():
            if any(p.stream_type() == colour for p in sensor.get_stream_profiles()) and sensor.supports(
                getattr(self._rs.option, name)
            ):
                return sensor
        raise CameraError(f"{self._name} takes no {name} for its colour: leave {name} out")

    def set_control(self, name: str, value: int) -> None:
        sensor, number = self._sensor(name), getattr(self._rs.option, name)
        automatic = getattr(self._rs.option, _AUTOMATIC[name])
        span = sensor.get_option_range(number)
        if not span.min <= value <= span.max:
            raise ConfigError(f"{self._name}: {name} {value} is out of range; it takes {span.min:g} to {span.max:g}")
        try:
            if sensor.supports(automatic):
                sensor.set_option(automatic, 0)
            sensor.set_option(number, value)
        except RuntimeError as error:
            raise CameraError(f"{self._name} does not take {name} {value}: {error}") from error

    def _why(self, error: RuntimeError, seen: VideoDevice | None) -> str:
        if any(word in str(error).lower() for word in _BUSY):
            nodes = [*seen.nodes, *([seen.usb_node] if seen.usb_node else [])] if seen else []
            return f"{self._name} is in use ({error}): {in_use(nodes)}"
        return f"{self._name} does not start: {error}; plug it in again, or into another USB 3 port"
