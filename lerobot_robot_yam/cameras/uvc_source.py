"""Camera read as a USB video device with OpenCV, colour only: any webcam, or a RealSense without librealsense."""

import os
import time
from pathlib import Path

import cv2

from lerobot_robot_yam.cameras import v4l2
from lerobot_robot_yam.cameras.picture_source import Picture, Wanted, no_depth
from lerobot_robot_yam.cameras.video_devices import VideoDevice, check_rights, in_use
from lerobot_robot_yam.errors import CameraError, ConfigError
from lerobot_robot_yam.system.own_commands import install_extra

# OpenCV's timeout for a V4L2 image, s (default 10). OpenCV reads this variable once, on import.
os.environ.setdefault("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", "1")

# Control of `Wanted` → V4L2 ids of the control and of its automatic mode, and the value that disables this mode.
_CONTROLS = {
    "exposure": (v4l2.EXPOSURE, v4l2.AUTO_EXPOSURE, v4l2.MANUAL),
    "gain": (v4l2.GAIN, v4l2.AUTO_EXPOSURE, v4l2.MANUAL),
    "white_balance": (v4l2.WHITE_BALANCE, v4l2.AUTO_WHITE_BALANCE, v4l2.OFF),
}
_COLOUR = ("YUYV", "MJPG", "NV12", "RGB3", "BGR3")  # formats that OpenCV converts, in order of preference
_SIZE = (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
_OLDEST_S = 10.0  # maximum plausible age of an image's own timestamp, s
_UNITS_PER_STEP = 100  # µs per step of V4L2's exposure; `Wanted.exposure` of a D405 is in µs


class UvcSource:
    """Open camera of `video_devices`: a `PictureSource` that provides only colour.

    Args:
        device: the camera.
        wanted: size, rate and controls.

    Raises:
        ConfigError: the camera does not support a size, rate, depth or value; the message lists supported values.
        CameraError: the camera is in use, access is denied, or there is no colour node.
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
            wants = zip((*_SIZE, cv2.CAP_PROP_FPS), (wanted.width, wanted.height, wanted.fps), strict=True)
            for number, value in wants if is_v4l2 else ():
                if value is not None:
                    self._capture.set(number, value)
            for name in _CONTROLS:
                if (asked := getattr(wanted, name)) is not None:
                    self.set_control(name, asked)
            width, height = (int(self._capture.get(number)) for number in _SIZE)
            if wanted.width is not None and (width, height) != (wanted.width, wanted.height):
                raise ConfigError(
                    f"{device} gives {width}x{height}, not {wanted.width}x{wanted.height}: set width and height to "
                    "what it gives"
                )
        except BaseException:
            self.close()
            raise

    def read(self) -> Picture:
        read, image = self._capture.read()
        now_s = time.monotonic()
        if not read:
            raise CameraError(f"{self._device} gives no picture: unplugged, stalled, or read by another program")
        # V4L2's stamp is the time at which the image began, independent of its wait in the queue.
        age_s = now_s - self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3
        stamp_s = now_s - age_s if self._node.is_char_device() and 0.0 <= age_s < _OLDEST_S else now_s
        return Picture(stamp_s, cv2.cvtColor(image, cv2.COLOR_BGR2RGB))

    def exposure_range(self) -> tuple[int, int]:
        _, unit, low, high = self._control("exposure")
        return low * unit, high * unit

    def set_control(self, name: str, value: int) -> None:
        node, unit, low, high = self._control(name)
        number, automatic, manual = _CONTROLS[name]
        steps = round(value / unit)
        if not low <= steps <= high:
            raise ConfigError(f"{self._device}: {name} {value} is out of range; it takes {low * unit} to {high * unit}")
        if v4l2.control_range(node, automatic) is not None:
            v4l2.set_control(node, automatic, manual)
        v4l2.set_control(node, number, steps)

    def close(self) -> None:
        self._capture.release()

    def _control(self, name: str) -> tuple[Path, int, int, int]:
        """Return the node that has a control, the unit of the control's steps, and the minimum and maximum step.

        A D405 has its exposure control on the depth node, so all nodes are tried, the colour node first.
        """
        unit = _UNITS_PER_STEP if name == "exposure" and self._device.stereo_colour else 1
        for node in dict.fromkeys((self._node, *self._device.nodes)):
            limits = v4l2.control_range(node, _CONTROLS[name][0])
            if limits is not None:
                return node, unit, *limits
        raise CameraError(
            f"{self._device} offers no {name} over UVC: leave {name} out, or read it with librealsense; "
            f"{install_extra('realsense')}"
        )


def _colour_node(device: VideoDevice) -> tuple[Path, list[v4l2.Mode]]:
    """Return the node that provides colour, and its formats; a plain file in a test's tree has no formats.

    Raises:
        CameraError: no node provides colour, or this user has no access to a node.
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
