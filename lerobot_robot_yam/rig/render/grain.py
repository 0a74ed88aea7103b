"""The grain of the table: planks along x. Made of random numbers, the same each time."""

import numpy as np

_PLANK_M = 0.175
_LEVEL = 224.0  # grey levels, by which the table's colour is multiplied; 255 is all of it
_TONE, _GRAIN, _SEAM = 6.0, 11.0, 38.0  # from plank to plank (sigma), within one (sigma), darker between two


def grain(pixels: tuple[int, int], width_m: float) -> np.ndarray:
    """(height, width) uint8 of a table that is `width_m` wide along y. pixels: along x and y."""
    width, height = pixels
    random = np.random.default_rng(7)
    planks = max(1, round(width_m / _PLANK_M))
    plank = np.arange(height) * planks // height
    fine, coarse = random.normal(size=(height, width)), random.normal(size=(height, width))
    tone = _TONE * random.normal(size=planks)[plank][:, None]
    streaks = _along(_along(fine, width // 6).T, 2).T + 0.8 * _along(_along(coarse, width // 3).T, 7).T
    level = _LEVEL + tone + _GRAIN * streaks / streaks.std()
    level[np.flatnonzero(np.diff(plank, prepend=0))] -= _SEAM
    return np.clip(level, 0, 255).astype(np.uint8)


def _along(noise: np.ndarray, length: int) -> np.ndarray:
    """Moving average of `length` along rows that go round, with standard deviation 1."""
    padded = np.concatenate([noise, noise[:, : length - 1]], axis=1)
    total = np.cumsum(np.pad(padded, ((0, 0), (1, 0))), axis=1)
    mean: np.ndarray = (total[:, length:] - total[:, :-length]) / length
    return mean / mean.std()
