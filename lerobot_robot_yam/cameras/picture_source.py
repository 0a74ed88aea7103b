"""Interface of open cameras, implemented for UVC and librealsense, and the settings that a user requests."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.own_commands import install_extra


@dataclass(frozen=True)
class Wanted:
    """Requested settings of a camera. None keeps the camera's present value.

    Attributes:
        serial: serial number, or the model if only one camera of this model is plugged in.
        width, height: image size in the camera, pixels.
        fps: frames per second.
        exposure: manual exposure, in µs if the stereo module provides the colour (D405), else in 100 µs.
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
        """Size and rate, formatted for messages."""
        return f"{self.width}x{self.height} at {self.fps} fps"


@dataclass(frozen=True)
class Picture:
    """Colour and depth images taken at the same time; None for a stream that is not read.

    Attributes:
        stamp_s: monotonic time of the image, s.
        colour: (height, width, 3) uint8 RGB.
        depth: (height, width, 1) uint16, mm.
    """

    stamp_s: float
    colour: np.ndarray | None = None
    depth: np.ndarray | None = None


def no_depth(camera: str) -> ConfigError:
    """Return the error for depth from a camera that is not read with librealsense."""
    return ConfigError(f"{camera}: depth takes librealsense: set use_depth to false, or {install_extra('realsense')}")


class PictureSource(Protocol):
    """An open camera."""

    def read(self) -> Picture:
        """Wait for the next image. Raises CameraError: the camera is disconnected or sends no images; then close it."""

    def exposure_range(self) -> tuple[int, int]:
        """Return minimum and maximum exposure, in the unit of `Wanted.exposure`. Raises CameraError: there is none."""

    def set_control(self, name: str, value: int) -> None:
        """Set exposure, gain or white_balance manually, each in the unit of `Wanted`.

        Raises:
            ConfigError: the value is out of range.
            CameraError: the camera has no such control, or does not accept the value.
        """

    def close(self) -> None:
        """Release the camera. Idempotent."""
