"""The exposure at which a picture is as bright as wanted, and nearly nothing of it is clipped."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

CLIPPED_AT = 250  # value of a colour, 0 to 255, from which a pixel counts as clipped
MOST_CLIPPED = 0.02  # share of clipped pixels that is accepted
TARGET, CLOSE = 0.45, 0.04  # mean brightness, 0 to 1: middle grey in a picture's own scale (sRGB), and its tolerance
MOST_TRIES = 12
_LUMA = (0.299, 0.587, 0.114)  # of red, green and blue, ITU-R BT.601


@dataclass(frozen=True)
class Brightness:
    """Brightness of a picture: the mean of all pixels, 0 to 1, and the share of pixels that are clipped."""

    mean: float
    clipped: float

    def __str__(self) -> str:
        return f"brightness {self.mean:.2f}, {self.clipped:.1%} clipped"

    def bad(self, target: float) -> float:
        """How far from what is wanted, 0 when it is met. 1 % too much that is clipped counts as 0.1 of brightness."""
        return abs(self.mean - target) + 10.0 * max(0.0, self.clipped - MOST_CLIPPED)


def brightness_of(colour: np.ndarray) -> Brightness:
    """Measure a picture, (height, width, 3) uint8 RGB."""
    return Brightness(float((colour @ _LUMA).mean()) / 255.0, float((colour.max(axis=2) >= CLIPPED_AT).mean()))


def find_exposure(
    measure: Callable[[int], Brightness], limits: tuple[int, int], target: float = TARGET
) -> list[tuple[int, Brightness]]:
    """Halve the range of exposures, on a logarithmic scale, until the picture is right or nothing is left to halve.

    Args:
        measure: sets an exposure and measures what comes of it.
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
