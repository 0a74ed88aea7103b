"""Looking through cameras from a command: a settled picture of each, their sheet, the search for an exposure."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from lerobot_robot_yam.cameras.contact_sheet import contact_sheet
from lerobot_robot_yam.cameras.exposure_search import Brightness, brightness_of, find_exposure
from lerobot_robot_yam.cameras.opening import Plugged
from lerobot_robot_yam.cameras.picture_source import PictureSource, Wanted
from lerobot_robot_yam.errors import SetupError

_SETTLE = 20  # pictures until a camera's own exposure has settled
_TAKES = 5  # pictures until an exposure that was set shows


class Bench:
    """Opens cameras one at a time, in one size and rate, and collects what they saw.

    Args:
        width, height: pixels.
        fps: pictures per second.
    """

    def __init__(self, width: int, height: int, fps: int):
        self._width, self._height, self._fps = width, height, fps
        self._pictures: list[tuple[str, np.ndarray | None]] = []

    def look(self, camera: Plugged, title: str) -> Brightness:
        """Take a settled picture for the sheet; returns how bright it is.

        Raises:
            CameraError, ConfigError: as the camera says.
        """
        source = camera.open(self._wanted(camera))
        try:
            return self._take(source, _SETTLE, title)
        finally:
            source.close()

    def miss(self, title: str) -> None:
        """Leave a field of the sheet empty."""
        self._pictures.append((f"{title}\nno picture", None))

    def tune(self, camera: Plugged, target: float, tell: Callable[[str], None]) -> tuple[Brightness, int, Brightness]:
        """Find an exposure; returns how bright it was before, the exposure, and how bright it is with it.

        Raises:
            CameraError, ConfigError: as the camera says; also where no exposure can be set.
        """
        source = camera.open(self._wanted(camera))
        try:
            limits = source.exposure_limits()
            before = self._take(source, _SETTLE, "before")

            def measure(exposure: int) -> Brightness:
                source.set_exposure(exposure)
                seen = _settled(source, _TAKES)[1]
                tell(f"exposure {exposure}: {seen}")
                return seen

            exposure, _ = find_exposure(measure, limits, target)[-1]
            source.set_exposure(exposure)
            return before, exposure, self._take(source, _TAKES, f"after, exposure {exposure}")
        finally:
            source.close()

    def write(self, path: Path) -> None:
        """Write the sheet.

        Raises:
            SetupError: the file cannot be written.
        """
        sheet = cv2.cvtColor(contact_sheet(self._pictures), cv2.COLOR_RGB2BGR)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(cv2.imencode(".png", sheet)[1].tobytes())
        except OSError as error:
            raise SetupError(f"{path} cannot be written: {error}") from error

    def _wanted(self, camera: Plugged) -> Wanted:
        return Wanted(camera.serial or "", self._width, self._height, self._fps)

    def _take(self, source: PictureSource, count: int, title: str) -> Brightness:
        colour, seen = _settled(source, count)
        self._pictures.append((f"{title}\n{seen}", colour))
        return seen


def _settled(source: PictureSource, count: int) -> tuple[np.ndarray, Brightness]:
    """The last of so many pictures, and its brightness."""
    for _ in range(count):
        colour = source.read().colour
    assert colour is not None, "colour was asked for"
    return colour, brightness_of(colour)
