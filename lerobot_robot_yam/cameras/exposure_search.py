"""Search for the exposure at which a picture is as bright as wanted, and nearly nothing of it is clipped."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

CLIPPED_AT = 250  # least value of a colour, 0 to 255, at which a pixel counts as clipped
MOST_CLIPPED = 0.02  # largest accepted share of clipped pixels
TARGET, CLOSE = 0.45, 0.04  # wanted mean brightness, 0 to 1, and its tolerance: middle grey in sRGB
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
        """Distance from the wanted brightness, 0 when met. 1 % too many clipped pixels count as 0.1 of brightness."""
        return abs(self.mean - target) + 10.0 * max(0.0, self.clipped - MOST_CLIPPED)


def brightness_of(colour: np.ndarray) -> Brightness:
    """Measure a picture, (height, width, 3) uint8 RGB."""
    return Brightness(float((colour @ _LUMA).mean()) / 255.0, float((colour.max(axis=2) >= CLIPPED_AT).mean()))


def find_exposure(
    measure: Callable[[int], Brightness], limits: tuple[int, int], target: float = TARGET
) -> list[tuple[int, Brightness]]:
    """Halve the range of exposures, on a logarithmic scale, until the picture is right or nothing is left to halve.

    Args:
        measure: sets an exposure and measures the picture.
        limits: least and greatest exposure of the camera.
        target: mean brightness, 0 to 1. A window or a lamp in the picture makes it darker than that, at most by half.

    Returns:
        Each exposure that was tried, at most `MOST_TRIES`, the best last.
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
