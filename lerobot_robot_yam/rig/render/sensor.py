"""What a camera's sensor adds to a picture: noise. Every exposure differs, also of a scene that stands still, so a
frame that was delivered twice can be told from two frames.
"""

import numpy as np

_MARGIN = 64  # a larger sheet of noise than the picture, cut elsewhere for each exposure


class Sensor:
    """Adds Gaussian noise of `sigma` grey levels to pictures of one size."""

    def __init__(self, width: int, height: int, sigma: float, seed: int = 0):
        self._random = np.random.default_rng(seed)
        sheet = self._random.normal(0.0, sigma, (height + _MARGIN, width + _MARGIN, 3))
        self._sheet = np.round(sheet).astype(np.int16)
        self._sum = np.empty((height, width, 3), np.int16)

    def expose(self, clean: np.ndarray, out: np.ndarray) -> None:
        """One exposure of the picture `clean` into `out`, both (height, width, 3) uint8."""
        height, width, _ = clean.shape
        top, left = self._random.integers(_MARGIN, size=2)
        np.add(clean, self._sheet[top : top + height, left : left + width], out=self._sum)
        np.clip(self._sum, 0, 255, out=self._sum)
        out[:] = self._sum
