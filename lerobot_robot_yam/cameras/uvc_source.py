"""A camera read as a USB video device through OpenCV: any webcam, and a RealSense without its library, colour only."""

import os
import time
from pathlib import Path

import cv2

from lerobot_robot_yam.cameras import v4l2
from lerobot_robot_yam.cameras.holders import check_rights, in_use
from lerobot_robot_yam.cameras.picture_source import Limits, Picture, Wanted, no_depth
from lerobot_robot_yam.cameras.video_devices import VideoDevice
from lerobot_robot_yam.errors import CameraError, ConfigError
from lerobot_robot_yam.system.own_commands import install_extra

# OpenCV waits so long (s) for a picture of V4L2, 10 s otherwise, before it says that there is none. It reads this once.
os.environ.setdefault("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", "1")

_COLOUR = ("YUYV", "MJPG", "NV12", "RGB3", "BGR3")  # formats that OpenCV converts, the best first
_OLDEST_S = 10.0  # a picture's own time stamp is believed up to this age
_UNITS_PER_STEP = 100  # of V4L2's exposure (100 µs), for cameras whose exposure librealsense gives in µs


class UvcSource:
    """An open camera of `video_devices`.

    Args:
        device: which.
        wanted: size, rate and controls.

    Raises:
        ConfigError: a size, rate, depth or value that it does not offer; says which it does.
        CameraError: no rights, in use, no colour node.
    """

    def __init__(self, device: VideoDevice, wanted: Wanted):
        if wanted.depth or not wanted.colour:
            raise no_depth(str(device))
        self._device = device
        self._node, modes = _colour_node(device)
        mode = _mode(device, modes, wanted)
        is_v4l2 = self._node.is_char_device()
        self._capture = cv2.VideoCapture(str(self._node), cv2.CAP_V4L2 if is_v4l2 else cv2.CAP_FFMPEG)
        try:
            if not self._capture.isOpened():
                raise CameraError(f"{device} cannot be opened: {in_use([self._node])}")
            if mode is not None:
                self._capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*mode.fourcc))
            for name, value in ((3, wanted.width), (4, wanted.height), (cv2.CAP_PROP_FPS, wanted.fps)):
                if value is not None and is_v4l2:
                    self._capture.set(name, value)
            self._set_controls(wanted)
            self._check_size(wanted)
        except BaseException:
            self.close()
            raise

    def read(self) -> Picture:
        """The next picture, colour only.

        Raises:
            CameraError: there is none: the camera is unplugged or has stalled, or another program reads it.
        """
        read, image = self._capture.read()
        now_s = time.monotonic()
        if not read:
            raise CameraError(f"{self._device} gives no picture: unplugged, stalled, or read by another program")
        # V4L2 stamps a picture when it begins; pictures that have waited in its queue are no new ones.
        age_s = now_s - self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3
        stamp_s = now_s - age_s if self._node.is_char_device() and 0.0 <= age_s < _OLDEST_S else now_s
        return Picture(stamp_s, cv2.cvtColor(image, cv2.COLOR_BGR2RGB))

    def exposure_limits(self) -> Limits:
        """What V4L2 takes, in our unit.

        Raises:
            CameraError: no node of the camera has an exposure.
        """
        _, limits = self._control(v4l2.EXPOSURE, "exposure")
        unit = self._exposure_unit
        return Limits(limits.minimum * unit, limits.maximum * unit)

    def set_exposure(self, exposure: int) -> None:
        """Set a manual exposure.

        Raises:
            CameraError: no node of the camera has an exposure.
            ConfigError: the value is out of range.
        """
        self._set(v4l2.EXPOSURE, "exposure", exposure, self._exposure_unit, v4l2.AUTO_EXPOSURE, v4l2.MANUAL)

    def close(self) -> None:
        """Release the camera. Idempotent."""
        self._capture.release()

    @property
    def _exposure_unit(self) -> int:
        return _UNITS_PER_STEP if self._device.stereo_colour else 1

    def _set_controls(self, wanted: Wanted) -> None:
        if wanted.exposure is not None:
            self.set_exposure(wanted.exposure)
        if wanted.gain is not None:
            self._set(v4l2.GAIN, "gain", wanted.gain, 1, v4l2.AUTO_EXPOSURE, v4l2.MANUAL)
        if wanted.white_balance is not None:
            kelvin = wanted.white_balance
            self._set(v4l2.WHITE_BALANCE, "white_balance", kelvin, 1, v4l2.AUTO_WHITE_BALANCE, v4l2.OFF)

    def _control(self, number: int, name: str) -> tuple[Path, v4l2.Control]:
        """The node that has a control, the colour's first: a D405 has its exposure on the node of depth."""
        for node in dict.fromkeys((self._node, *self._device.nodes)):
            control = v4l2.control(node, number)
            if control is not None:
                return node, control
        raise CameraError(
            f"{self._device} offers no {name} over UVC: leave {name} out, or read it with librealsense; "
            f"{install_extra('realsense')}"
        )

    def _set(self, number: int, name: str, value: int, unit: int, automatic: int, off: int) -> None:
        node, control = self._control(number, name)
        steps = round(value / unit)
        if not control.minimum <= steps <= control.maximum:
            raise ConfigError(
                f"{self._device}: {name} {value} is out of range; it takes {control.minimum * unit} to "
                f"{control.maximum * unit}"
            )
        if v4l2.control(node, automatic) is not None:
            v4l2.set_control(node, automatic, off)
        v4l2.set_control(node, number, steps)

    def _check_size(self, wanted: Wanted) -> None:
        if wanted.width is None:
            return
        width, height = (int(self._capture.get(name)) for name in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        if (width, height) != (wanted.width, wanted.height):
            raise ConfigError(
                f"{self._device} gives {width}x{height}, not {wanted.width}x{wanted.height}: set width and height to "
                "what it gives"
            )


def _colour_node(device: VideoDevice) -> tuple[Path, list[v4l2.Mode]]:
    """The node that gives colour, and what it offers: nothing where it is a file, of a tree made for a test.

    Raises:
        CameraError: there is none, or no right to open it.
    """
    if not device.nodes:
        raise CameraError(
            f"{device} has no video node: another program may read it with librealsense; end that, or plug it in again"
        )
    for node in device.nodes:
        check_rights(node)
        if not node.is_char_device():
            return node, []
        modes = [mode for mode in v4l2.modes(node) if mode.fourcc in _COLOUR]
        if modes:
            return node, modes
    raise CameraError(f"{device} gives no colour on {', '.join(map(str, device.nodes))}: plug it in again")


def _mode(device: VideoDevice, modes: list[v4l2.Mode], wanted: Wanted) -> v4l2.Mode | None:
    if not modes or wanted.width is None:
        return None
    fitting = [m for m in modes if (m.width, m.height) == (wanted.width, wanted.height) and wanted.fps in m.rates]
    if not fitting:
        raise ConfigError(f"{device} does not offer {wanted.size}; it offers {', '.join(map(str, modes))}")
    return min(fitting, key=lambda mode: _COLOUR.index(mode.fourcc))
