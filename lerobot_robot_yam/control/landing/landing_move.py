"""Shared parts of the landing phases: measured inputs, and motion of the set-point."""

from enum import Enum, auto
from typing import NamedTuple

import numpy as np

from lerobot_robot_yam.control.laws.set_point import SetPoint

LANDING_SPEED_RAD_S = 0.6
"""Maximum joint speed of a landing."""
_COMMANDED_RAD_S = 0.52  # commanded speed; overcompensated gravity makes an arm up to 12 % faster
_RAMP_S = 0.12  # time to reach the commanded speed; a quicker start overshoots
_SOFT_RAD_S2 = 5.0  # acceleration limit near the goal of the fold: some joints end on their mechanical stops
_SAG_NM = 5.0  # maximum torque of a load, 2 kg at 0.25 m; more torque means an obstacle
_FELL_BACK_RAD = 0.02  # set-point step away from the goal in one tick that means that the joint was struck and caught


class Phase(Enum):
    """Phase of a landing."""

    FOLD = auto()
    LOWER = auto()
    FADE = auto()
    SINK = auto()
    LANDED = auto()
    OBSTRUCTED = auto()


class Seen(NamedTuple):
    """Measured inputs of a landing at one tick, for n joints.

    Attributes:
        now: time, s.
        q, dq: (n,) measured position and speed, rad, rad/s.
        usable: (n,) bool, joints whose motors reply; the landing does not wait for other joints.
        explained: whether a wrong gravity model can explain the distance to the set-point.
        pulls: (n,) direction of gravity, -1 or 1, for joints with silent motors that may obey; 0 for other joints.
    """

    now: float
    q: np.ndarray
    dq: np.ndarray
    usable: np.ndarray
    explained: bool = True
    pulls: np.ndarray | float = 0.0


class Patience:
    """Timer of how long a condition has held without interruption."""

    def __init__(self) -> None:
        self._since_s: float | None = None

    def ends(self, condition: bool, now: float, after_s: float) -> bool:
        """Return whether the condition has held for `after_s`. Call at each tick."""
        if not condition:
            self._since_s = None
            return False
        self._since_s = now if self._since_s is None else self._since_s
        return now - self._since_s > after_s


class LandingMove:
    """Mover of a set-point's first n coordinates; the set-point's limits are lowered and not restored.

    Args:
        setpoint: the arm's set-point.
        kp: (n,) position gains, Nm/rad.

    Attributes:
        unheard: (n,) bool, joints whose motors have not replied since the start of the move.
        sag_rad: (n,) maximum distance from the set-point caused by a load, rad.
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
        """Vector (n,) from the set-point to its goal, rad; the goal is clamped to the joint limits."""
        left: np.ndarray = self._setpoint.target[: self._n] - self.q
        return left

    @property
    def arrived(self) -> bool:
        """Whether the set-point rests at its goal."""
        return self._setpoint.arrived

    def begin(self, goal: np.ndarray, now: float) -> None:
        """Begin a straight path to goal (n,), with all joints arriving at the same time."""
        self._since_s = now
        self.unheard[:] = True
        self._left = gap = np.abs(goal - self.q)
        self._speed = np.maximum(_COMMANDED_RAD_S * gap / max(float(gap.max()), 1e-3), 0.05)
        self._ramp(now)
        target = self._setpoint.q.copy()
        target[: self._n] = goal
        self._setpoint.set_target(target, now)

    def advance(self, now: float, usable: np.ndarray) -> None:
        """Advance by one tick. usable: (n,) bool, joints whose motors reply."""
        left = np.abs(self.way)
        if (left > self._left + _FELL_BACK_RAD).any():
            self.begin(self._setpoint.target[: self._n].copy(), now)  # else the struck joint would crawl
        self._left = left
        self._ramp(now)
        self.unheard &= ~usable

    def _ramp(self, now: float) -> None:
        self._setpoint.limit_speed(self._speed * np.clip((now - self._since_s) / _RAMP_S, 0.1, 1.0))

    def soften(self) -> None:
        """Lower the acceleration limit for the rest of the landing."""
        self._setpoint.limit_acceleration(np.full(self._n, _SOFT_RAD_S2))

    def near(self, setpoint: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Clip the set-point (n,) to within `sag_rad` of q (n,), enough torque for an unknown load."""
        nearest: np.ndarray = np.minimum(np.maximum(setpoint, q - self.sag_rad), q + self.sag_rad)
        return nearest

    def give_way(self, q: np.ndarray, joints: np.ndarray) -> None:
        """Restart the set-point, at rest: at q (n,) for `joints`, (n,) bool, at its present value for the others."""
        seed = self._setpoint.q.copy()
        seed[: self._n] = np.where(joints, q, seed[: self._n])
        self._setpoint.seed(seed)
