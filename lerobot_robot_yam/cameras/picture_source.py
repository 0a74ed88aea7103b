"""Interface of open cameras (classes for UVC and librealsense implement it), and the settings that a person wants."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.own_commands import install_extra


@dataclass(frozen=True)
class Wanted:
    """Wanted settings of a camera. None leaves a setting as it is in the camera.

    Attributes:
        serial: serial number, or the model if there is only one of it.
        width, height: size of the pictures in the camera, pixels.
        fps: pictures per second.
        exposure: manual exposure, in µs where the colour comes from the stereo module (D405), else in 100 µs.
        gain: manual gain, in the camera's own unit.
        white_balance: manual white balance, K.
    """

    serial: str
    width: int | None = None
    height: int | None = None
    fps: int | None = None
    colour: bool = True
    depth: bool = False
    exposure: int | None = None
    gain: int | None = None
    white_balance: int | None = None

    @property
    def size(self) -> str:
        """Size and rate, for messages."""
        return f"{self.width}x{self.height} at {self.fps} fps"


@dataclass(frozen=True)
class Picture:
    """Picture of one moment.

    Attributes:
        stamp_s: monotonic time of the picture, s.
        colour: (height, width, 3) uint8 RGB.
        depth: (height, width, 1) uint16, mm.
    """

    stamp_s: float
    colour: np.ndarray | None = None
    depth: np.ndarray | None = None


def no_depth(camera: str) -> ConfigError:
    """Return the error for depth from a camera that librealsense does not read."""
    return ConfigError(f"{camera}: depth takes librealsense: set use_depth to false, or {install_extra('realsense')}")


class PictureSource(Protocol):
    """Open camera."""

    def read(self) -> Picture:
        """Wait for the next picture. Raises CameraError: the camera is gone, or gives no picture; close it then."""

    def exposure_range(self) -> tuple[int, int]:
        """Return least and greatest exposure, in `Wanted.exposure`'s unit. Raises CameraError: there is none."""

    def set_control(self, name: str, value: int) -> None:
        """Set exposure, gain or white_balance, each in the unit of `Wanted`, by hand.

        Raises:
            ConfigError: the value is out of range.
            CameraError: the camera has no such control, or does not accept the value.
        """

    def close(self) -> None:
        """Release the camera. Idempotent."""
