"""A point that glides to a goal with limited speed and acceleration, of n coordinates."""

import numpy as np


class Glide:
    """As made it is nowhere: `seed` first.

    Args:
        acceleration: (n,) unit/s², with which it starts and stops.

    Attributes:
        q, dq: (n,) where it is, and its speed.
    """

    def __init__(self, acceleration: np.ndarray):
        self._acceleration = acceleration
        self.q: np.ndarray = np.zeros(len(acceleration))
        self.dq: np.ndarray = np.zeros(len(acceleration))

    def seed(self, q: np.ndarray, dq: np.ndarray | None = None) -> None:
        """Start at q (n,), at rest or with speed dq (n,)."""
        self.q = q.copy()
        self.dq = np.zeros(len(q)) if dq is None else dq.copy()

    def advance(self, goal: np.ndarray, speed: np.ndarray, dt: float) -> None:
        """Glide on towards goal (n,), at `speed` (n,) at most.  |dq| ≤ sqrt(2 a |goal − q|)."""
        if dt <= 0.0:
            return
        gap = goal - self.q
        most = np.minimum(speed, np.minimum(np.sqrt(2.0 * self._acceleration * np.abs(gap)), np.abs(gap) / dt))
        step = self._acceleration * dt
        wanted = np.copysign(most, gap)
        self.dq = self.dq + np.minimum(np.maximum(wanted - self.dq, -step), step)
        self.q = self.q + self.dq * dt

    def keep_near(self, q: np.ndarray, reach: np.ndarray) -> None:
        """Do not be farther than `reach` (n,) from q (n,)."""
        self.q = np.minimum(np.maximum(self.q, q - reach), q + reach)
