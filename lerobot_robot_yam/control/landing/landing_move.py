"""Shared parts of the phases of a landing: what they see of the arm, and how they move its set-point."""

from enum import Enum, auto
from typing import NamedTuple

import numpy as np

from lerobot_robot_yam.control.laws.set_point import SetPoint

LANDING_SPEED_RAD_S = 0.6
"""No joint lands faster."""
_COMMANDED_RAD_S = 0.52  # commanded speed: arms reach up to 12 % more where their weight is overcompensated
_RAMP_S = 0.12  # time to reach that speed; a quicker start overshoots
_SOFT_RAD_S2 = 5.0  # acceleration near the goal of the fold: some joints end on their mechanical stops
_SAG_NM = 5.0  # largest torque of a load, 2 kg at 0.25 m; a joint pulled back by more meets an obstacle
_FELL_BACK_RAD = 0.02  # way back of a set-point in one tick that means that its joint was struck and caught


class Phase(Enum):
    """Phase of a landing."""

    FOLD = auto()
    LOWER = auto()
    FADE = auto()
    SINK = auto()
    LANDED = auto()
    OBSTRUCTED = auto()


class Seen(NamedTuple):
    """An arm's n joints at one tick.

    Attributes:
        now: time, s.
        q, dq: (n,) measured, rad, rad/s.
        usable: (n,) bool, joints whose motors answer; the others cannot be waited for.
        explained: whether a wrong model can explain the distance to the set-point.
        pulls: (n,) the direction, -1 or 1, in which weight pulls a joint that is not heard and may obey; else 0.
    """

    now: float
    q: np.ndarray
    dq: np.ndarray
    usable: np.ndarray
    explained: bool = True
    pulls: np.ndarray | float = 0.0


class Patience:
    """Measure of how long a condition has held without a break."""

    def __init__(self) -> None:
        self._since_s: float | None = None

    def ends(self, condition: bool, now: float, after_s: float) -> bool:
        """Return whether the condition has held for `after_s`; call this at each tick."""
        if not condition:
            self._since_s = None
            return False
        self._since_s = now if self._since_s is None else self._since_s
        return now - self._since_s > after_s


class LandingMove:
    """Mover of the first n coordinates of a set-point; the set-point's limits are lowered for good.

    Args:
        setpoint: the arm's set-point.
        kp: (n,) position gains, Nm/rad.

    Attributes:
        unheard: (n,) bool, joints whose motors have not answered since the move began.
        sag_rad: (n,) rad, how far a load may pull each joint off its set-point.
    """

    def __init__(self, setpoint: SetPoint, kp: np.ndarray):
        self._setpoint, self._n = setpoint, len(kp)
        self._since_s = 0.0
        self._speed: np.ndarray = np.zeros(self._n)
        self._left: np.ndarray = np.zeros(self._n)
        self.unheard = np.ones(self._n, dtype=bool)
        self.sag_rad: np.ndarray = _SAG_NM / np.maximum(kp, 1.0)

    @property
    def q(self) -> np.ndarray:
        """The set-point (n,), rad."""
        return self._setpoint.q[: self._n]

    @property
    def way(self) -> np.ndarray:
        """Way (n,) from the set-point to its goal, rad; a base beyond its limit comes inside on its way."""
        left: np.ndarray = self._setpoint.target[: self._n] - self.q
        return left

    @property
    def arrived(self) -> bool:
        """Whether the set-point rests at its goal."""
        return self._setpoint.arrived

    def begin(self, goal: np.ndarray, now: float) -> None:
        """Begin a straight line to goal (n,), on which every joint arrives at the same time."""
        self._since_s = now
        self.unheard[:] = True
        self._left = gap = np.abs(goal - self.q)
        self._speed = np.maximum(_COMMANDED_RAD_S * gap / max(float(gap.max()), 1e-3), 0.05)
        self._ramp(now)
        target = self._setpoint.q.copy()
        target[: self._n] = goal
        self._setpoint.set_target(target, now)

    def advance(self, now: float, usable: np.ndarray) -> None:
        """Advance by one tick. usable: (n,) bool, joints whose motors answer."""
        left = np.abs(self.way)
        if (left > self._left + _FELL_BACK_RAD).any():
            self.begin(self._setpoint.target[: self._n].copy(), now)  # else that joint would crawl
        self._left = left
        self._ramp(now)
        self.unheard &= ~usable

    def _ramp(self, now: float) -> None:
        self._setpoint.limit_speed(self._speed * np.clip((now - self._since_s) / _RAMP_S, 0.1, 1.0))

    def soften(self) -> None:
        """Accelerate softly from now on."""
        self._setpoint.limit_acceleration(np.full(self._n, _SOFT_RAD_S2))

    def near(self, setpoint: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Clip the set-point (n,) to `sag_rad` from q (n,): enough pull for an unknown load, little without one."""
        nearest: np.ndarray = np.minimum(np.maximum(setpoint, q - self.sag_rad), q + self.sag_rad)
        return nearest

    def give_way(self, q: np.ndarray, joints: np.ndarray) -> None:
        """Move the set-point to q (n,), at rest, for these joints, (n,) bool; the others rest where they are."""
        seed = self._setpoint.q.copy()
        seed[: self._n] = np.where(joints, q, seed[: self._n])
        self._setpoint.seed(seed)
