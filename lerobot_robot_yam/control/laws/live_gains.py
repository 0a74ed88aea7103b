"""Gains that a caller changes while the arm is energised: they go over to the new ones, and no torque jumps."""

import numpy as np

_GLIDE_S = 0.5


class LiveGains:
    """Stiffness and damping of n motors.

    kp(t) = kp0 + (kp1 - kp0) t / T, kd alike: damping that suits both ends suits the way between them, too.

    Args:
        kp, kd: (n,) as configured, Nm/rad and Nm s/rad.

    Attributes:
        kp, kd: (n,) in force.
    """

    def __init__(self, kp: np.ndarray, kd: np.ndarray):
        self._configured = np.array((kp, kd))
        self._now, self._goal = self._configured, self._configured
        self._step = np.zeros_like(self._now)  # per second

    @property
    def kp(self) -> np.ndarray:
        """(n,) Nm/rad."""
        stiffness: np.ndarray = self._now[0]
        return stiffness

    @property
    def kd(self) -> np.ndarray:
        """(n,) Nm s/rad."""
        damping: np.ndarray = self._now[1]
        return damping

    def change(self, kp: np.ndarray, kd: np.ndarray) -> None:
        """Begin to go over to these (n,); NaN is as configured."""
        wanted = np.array((kp, kd))
        self._goal = np.where(np.isnan(wanted), self._configured, wanted)
        self._step = (self._goal - self._now) / _GLIDE_S

    def advance(self, dt: float) -> bool:
        """Go on for `dt` s. True while they change."""
        if self._now is self._goal:
            return False
        way, step = self._goal - self._now, self._step * dt
        there = np.abs(step) >= np.abs(way)
        self._now = self._goal if there.all() else np.where(there, self._goal, self._now + step)
        return True

    def reset(self) -> None:
        """As configured, at once."""
        self._now = self._goal = self._configured
