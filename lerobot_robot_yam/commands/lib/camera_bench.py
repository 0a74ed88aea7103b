"""Camera tests for `yam-cameras`: settled pictures, a sheet with all pictures, and the search for an exposure."""

import math
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from lerobot_robot_yam.cameras.opening import Plugged
from lerobot_robot_yam.cameras.picture_source import PictureSource, Wanted
from lerobot_robot_yam.errors import SetupError
from lerobot_robot_yam.system.paths import write_whole

_SETTLE = 20  # pictures to read until the automatic exposure has settled
_TAKES = 5  # pictures to read until a new exposure takes effect
_WIDTH, _HEIGHT, _WORDS = 480, 360, 44  # _WIDTH, _HEIGHT: picture size on the sheet, px; _WORDS: caption height, px
_GREY, _WHITE = 40, (255, 255, 255)
CLIPPED_AT = 250  # colour value, 0 to 255, from which a pixel counts as clipped
MOST_CLIPPED = 0.02  # maximum accepted share of clipped pixels
TARGET, CLOSE = 0.45, 0.04  # TARGET: wanted mean brightness, 0 to 1, middle grey in sRGB; CLOSE: its tolerance
MOST_TRIES = 12
_LUMA = (0.299, 0.587, 0.114)  # weights of red, green and blue in brightness, ITU-R BT.601


@dataclass(frozen=True)
class Brightness:
    """Brightness of a picture: mean of all pixels, 0 to 1, and share of clipped pixels."""

    mean: float
    clipped: float

    def __str__(self) -> str:
        return f"brightness {self.mean:.2f}, {self.clipped:.1%} clipped"

    def bad(self, target: float) -> float:
        """Return the deviation from the wanted brightness, ≥ 0; each 1 % of clipped pixels above the limit adds 0.1."""
        return abs(self.mean - target) + 10.0 * max(0.0, self.clipped - MOST_CLIPPED)


def brightness_of(colour: np.ndarray) -> Brightness:
    """Return the brightness of a picture, (height, width, 3) uint8 RGB."""
    return Brightness(float((colour @ _LUMA).mean()) / 255.0, float((colour.max(axis=2) >= CLIPPED_AT).mean()))


class Bench:
    """Picture collector that opens cameras one at a time, all with the same size and rate.

    Args:
        width, height: size of the pictures, pixels.
        fps: pictures per second.
    """

    def __init__(self, width: int, height: int, fps: int):
        self._width, self._height, self._fps = width, height, fps
        self._pictures: list[tuple[str, np.ndarray | None]] = []

    def look(self, camera: Plugged, title: str) -> Brightness:
        """Take a settled picture for the sheet; return its brightness.

        Raises:
            CameraError, ConfigError: the camera fails, or does not support the size or rate.
        """
        with closing(self._opened(camera)) as source:
            return self._take(source, _SETTLE, title)

    def miss(self, title: str) -> None:
        """Add a field without a picture to the sheet."""
        self._pictures.append((f"{title}\nno picture", None))

    def tune(self, camera: Plugged, target: float, tell: Callable[[str], None]) -> tuple[Brightness, int, Brightness]:
        """Find an exposure; return the brightness before, the exposure, and the brightness after.

        Raises:
            CameraError, ConfigError: the camera fails, or its exposure cannot be set.
        """
        with closing(self._opened(camera)) as source:
            limits = source.exposure_range()
            before = self._take(source, _SETTLE, "before")

            def measure(exposure: int) -> Brightness:
                source.set_control("exposure", exposure)
                seen = _settled(source, _TAKES)[1]
                tell(f"exposure {exposure}: {seen}")
                return seen

            exposure, _ = find_exposure(measure, limits, target)[-1]
            source.set_control("exposure", exposure)
            return before, exposure, self._take(source, _TAKES, f"after, exposure {exposure}")

    def write(self, path: Path) -> None:
        """Write the sheet of pictures as a PNG file.

        Raises:
            SetupError: the file cannot be written.
        """
        sheet = cv2.cvtColor(_sheet(self._pictures), cv2.COLOR_RGB2BGR)
        try:
            write_whole(path, cv2.imencode(".png", sheet)[1].tobytes())
        except OSError as error:
            raise SetupError(f"{path} cannot be written: {error}") from error

    def _opened(self, camera: Plugged) -> PictureSource:
        return camera.open(Wanted(camera.serial or "", self._width, self._height, self._fps))

    def _take(self, source: PictureSource, count: int, title: str) -> Brightness:
        colour, seen = _settled(source, count)
        self._pictures.append((f"{title}\n{seen}", colour))
        return seen


def find_exposure(
    measure: Callable[[int], Brightness], limits: tuple[int, int], target: float = TARGET
) -> list[tuple[int, Brightness]]:
    """Find an exposure by bisection on a logarithmic scale, until the brightness is close to the target.

    Args:
        measure: function that sets an exposure and measures the picture.
        limits: minimum and maximum exposure of the camera.
        target: mean brightness, 0 to 1; half of it is accepted if bright parts, such as a window, would clip.

    Returns:
        The exposures tried, at most `MOST_TRIES`, and their brightness; the best exposure is last.
    """
    low, high = max(1, limits[0]), limits[1]
    tried: dict[int, Brightness] = {}
    while len(tried) < MOST_TRIES:
        exposure = round(math.sqrt(low * high))
        if exposure in tried:
            break
        seen = tried[exposure] = measure(exposure)
        too_bright = seen.mean > target or (seen.clipped > MOST_CLIPPED and seen.mean > target / 2)
        if seen.clipped <= MOST_CLIPPED and abs(seen.mean - target) <= CLOSE:
            break
        low, high = (low, exposure) if too_bright else (exposure, high)
    return sorted(tried.items(), key=lambda row: row[1].bad(target), reverse=True)


def _settled(source: PictureSource, count: int) -> tuple[np.ndarray, Brightness]:
    """Read `count` pictures; return the last picture and its brightness."""
    for _ in range(count):
        colour = source.read().colour
    assert colour is not None, "colour was asked for"
    return colour, brightness_of(colour)


def _sheet(pictures: Sequence[tuple[str, np.ndarray | None]]) -> np.ndarray:
    """Return the sheet, (rows · 404, columns · 480, 3) uint8 RGB, with a field per picture; missing pictures are grey.

    Args:
        pictures: caption (at most two lines) and picture (height, width, 3) of each field.
    """
    columns = math.ceil(math.sqrt(len(pictures)))
    rows = math.ceil(len(pictures) / columns)
    sheet = np.full((rows * (_HEIGHT + _WORDS), columns * _WIDTH, 3), _GREY, np.uint8)
    for place, (words, picture) in enumerate(pictures):
        top, left = (place // columns) * (_HEIGHT + _WORDS), (place % columns) * _WIDTH
        if picture is not None:
            scale = min(_WIDTH / picture.shape[1], _HEIGHT / picture.shape[0])
            small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)[:_HEIGHT, :_WIDTH]
            y, x = top + (_HEIGHT - small.shape[0]) // 2, left + (_WIDTH - small.shape[1]) // 2
            sheet[y : y + small.shape[0], x : x + small.shape[1]] = small
        for line, text in enumerate(words.split("\n")[:2]):
            where = (left + 6, top + _HEIGHT + 17 + 20 * line)
            cv2.putText(sheet, text, where, cv2.FONT_HERSHEY_SIMPLEX, 0.48, _WHITE, 1, cv2.LINE_AA)
    return sheet
