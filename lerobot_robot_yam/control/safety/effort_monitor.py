"""Effort limit: torque above it for longer than a knock lasts means that the arm presses on something it should not."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

PATIENCE_S = 0.05  # knocks and starts are shorter


@dataclass(frozen=True)
class EffortVerdict:
    """The joint that exceeded its limit most, relative to it."""

    joint: str
    torque_nm: float
    limit_nm: float

    def __str__(self) -> str:
        return f"{self.joint} works with {self.torque_nm:.1f} Nm against its effort limit of {self.limit_nm:.1f} Nm"


class EffortLimit:
    """Watches the measured torque of n motors. Ask once per tick.

    Args:
        limit_nm: (n,) largest |tau|; infinity where there is none.
        names: of the joints.
    """

    def __init__(self, limit_nm: np.ndarray, names: Sequence[str]):
        self._limit = np.array(limit_nm, dtype=float)
        self._names = tuple(names)
        self._since: np.ndarray = np.full(len(self._limit), math.inf)

    def check(self, now: float, tau_nm: np.ndarray) -> EffortVerdict | None:
        """A verdict as long as a torque (n,) Nm has been above its limit for more than PATIENCE_S."""
        above = np.abs(tau_nm) > self._limit
        self._since = np.where(above, np.minimum(self._since, now), math.inf)
        over = now - self._since > PATIENCE_S
        if not over.any():
            return None
        worst = int(np.where(over, np.abs(tau_nm) / self._limit, 0.0).argmax())
        return EffortVerdict(self._names[worst], float(tau_nm[worst]), float(self._limit[worst]))
