"""How fast an arm is moved for Commander: one table. Joint speeds come from the arm's own configuration."""

from numbers import Real
from typing import NamedTuple

import numpy as np

from lerobot_robot_yam.errors import PlanError

JOINT_ACCELERATION_RAD_S2 = 6.0  # ours: 1.5 rad/s after 0.35 s; the control loop's set-point can do 30
JOINT_JERK_RAD_S3 = 60.0  # ours: full acceleration after 0.1 s
STOP_FACTOR = 2.0  # of both when the arm is stopped: from 1.5 rad/s it is still after 0.23 s
LINE_SPEED_M_S, LINE_SPEED_RAD_S = 0.25, 1.2  # ours: a hand beside the arm can follow it
LINE_ACCELERATION_M_S2, LINE_ACCELERATION_RAD_S2 = 1.0, 5.0  # ours: full speed after 0.35 s
LINE_RAMP_S = 0.1  # to full acceleration
JOG_SHARE = 0.5  # of the joints' speed limits, for jogging
DEFAULT_SPEED = 0.5  # share of the limits, for a command that says 0
LEAST_ACCELERATION = 0.05  # share: Commander's slider goes down to 0
HOME_RAD = np.radians([0.0, 60.0, 60.0, -29.0, 0.0, 0.0])
"""Where `home` goes, off every limit and off gimbal lock: the upper arm raised, the tool 29° below the level."""


class Limits(NamedTuple):
    """Of n coordinates: speed (n,) unit/s, acceleration (n,) unit/s², jerk (n,) unit/s³."""

    speed: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray

    def scaled(self, speed: float, acceleration: float) -> "Limits":
        """These shares of them; the jerk goes with the acceleration."""
        return Limits(speed * self.speed, acceleration * self.acceleration, acceleration * self.jerk)


def joint_limits(speed_rad_s: np.ndarray) -> Limits:
    """Of joints that may turn with speed_rad_s (n,)."""
    n = len(speed_rad_s)
    return Limits(speed_rad_s.copy(), np.full(n, JOINT_ACCELERATION_RAD_S2), np.full(n, JOINT_JERK_RAD_S3))


def shares(speed: float, accel: float, duration_s: float) -> tuple[float, float]:
    """Shares of the speed and acceleration limits that a command asks for.

    Args:
        speed, accel: 0 … 1; a speed of 0 is `DEFAULT_SPEED`.
        duration_s: above 0 it counts in place of the speed.

    Raises:
        PlanError: not numbers, or outside these ranges.
    """
    for name, value, most in (("speed", speed, 1.0), ("accel", accel, 1.0), ("duration", duration_s, 3600.0)):
        if not (isinstance(value, Real) and 0.0 <= value <= most):
            raise PlanError(f"{name} has to be a number from 0 to {most:g}, not {value!r}")
    return 1.0 if duration_s > 0.0 else float(speed) or DEFAULT_SPEED, max(float(accel), LEAST_ACCELERATION)
