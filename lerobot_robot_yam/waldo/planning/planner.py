"""Plans of one arm: the only place where commands become motions, for the dry run, the simulator and a real arm alike.

Nothing here reads a clock or a motor, and the same call gives the same plan. What cannot be done is refused before
anything moves.
"""

import math
from numbers import Real

import numpy as np

from lerobot_robot_yam.arm.collision.workspace import WorkspaceConfig
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.errors import PlanError
from lerobot_robot_yam.waldo.planning import ruckig_motion
from lerobot_robot_yam.waldo.planning.motion_plan import Plan
from lerobot_robot_yam.waldo.planning.ruckig_motion import Limits

JOINT_ACCELERATION_RAD_S2 = 6.0  # ours: 1.5 rad/s after 0.3 s; the control loop's set-point can do 30
JOINT_JERK_RAD_S3 = 60.0  # ours: full acceleration after 0.1 s
STOP_FACTOR = 2.0  # of these two when the arm is stopped: from 1.5 rad/s it is still after 0.2 s
DEFAULT_SPEED = 0.5  # share of the limits for a command that says 0
LEAST_ACCELERATION = 0.05  # share: Commander's slider goes down to 0
HOME_RAD = np.radians([0.0, 60.0, 60.0, -29.0, 0.0, 0.0])
"""Where `home` goes: off every limit, off gimbal lock, the tool level above the table."""
_ROUNDING_RAD = 1e-4  # by which a target may miss a limit: degrees as text


class Planner:
    """Plans motions of an arm's joints. Not thread-safe.

    Args:
        hardware: the arm.
        workspace: what it keeps away from; None: as configured.

    Attributes:
        home_q: (n,) rad.
    """

    def __init__(self, hardware: ResolvedArm, workspace: WorkspaceConfig | None = None):
        self._name, self._joint_names = hardware.name, hardware.joint_names
        n = hardware.joints
        self.lower, self.upper = hardware.lower[:n], hardware.upper[:n]
        self.limits = Limits(
            hardware.speed_limit[:n], np.full(n, JOINT_ACCELERATION_RAD_S2), np.full(n, JOINT_JERK_RAD_S3)
        )
        self.home_q = HOME_RAD.copy()

    def joints(
        self,
        start_q: np.ndarray,
        target_q: np.ndarray,
        *,
        speed: float = 0.0,
        accel: float = 1.0,
        duration_s: float = 0.0,
        start_dq: np.ndarray | None = None,
    ) -> Plan:
        """A move of the joints.

        Args:
            start_q: (n,) rad, the set-point.
            target_q: (n,) rad.
            speed, accel: shares 0 … 1 of the limits; a speed of 0 is `DEFAULT_SPEED`.
            duration_s: above 0 it counts in place of `speed`.
            start_dq: (n,) rad/s, of a set-point that moves.

        Raises:
            PlanError: malformed, beyond a limit, too fast, or in the way of something.
        """
        target = self.within(target_q)
        limits = self._limits(speed, accel, duration_s)
        moving = np.zeros(len(target)) if start_dq is None else np.asarray(start_dq, dtype=float)
        return ruckig_motion.move(np.asarray(start_q, dtype=float), moving, target, limits, duration_s)

    def home(self, start_q: np.ndarray, *, speed: float = 0.0, accel: float = 1.0) -> Plan:
        """A move of the joints to `home_q`; as `joints`."""
        return self.joints(start_q, self.home_q, speed=speed, accel=accel)

    def stop(self, q: np.ndarray, dq: np.ndarray) -> Plan:
        """From a set-point (n,) rad that moves with dq (n,) rad/s to rest, harder than a move brakes."""
        return ruckig_motion.brake(q, dq, self.limits.scaled(1.0, STOP_FACTOR))

    def within(self, q: np.ndarray) -> np.ndarray:
        """`q` as (n,) floats, rounding at the limits taken off.

        Raises:
            PlanError: names the joint that is beyond its limit, or says what is malformed.
        """
        try:
            given = np.array(q, dtype=float)
        except (TypeError, ValueError):
            given = np.zeros(0)
        if given.shape != self.lower.shape or not np.isfinite(given).all():
            raise PlanError(f"{self._name}: a target takes {len(self.lower)} finite joint angles, not {q!r}")
        over = np.maximum(self.lower - given, given - self.upper)
        worst = int(over.argmax())
        if over[worst] > _ROUNDING_RAD:
            low, high = np.degrees([self.lower[worst], self.upper[worst]])
            raise PlanError(
                f"{self._name}: {self._joint_names[worst]} would be at {math.degrees(given[worst]):.2f}°, beyond its "
                f"limits {low:.2f}° … {high:.2f}°"
            )
        return np.clip(given, self.lower, self.upper)

    def _limits(self, speed: float, accel: float, duration_s: float) -> Limits:
        for name, value, most in (("speed", speed, 1.0), ("accel", accel, 1.0), ("duration", duration_s, math.inf)):
            if not (isinstance(value, Real) and math.isfinite(value) and 0.0 <= value <= most):
                raise PlanError(f"{self._name}: {name} has to be a number from 0 to {most:g}, not {value!r}")
        share = 1.0 if duration_s > 0.0 else speed or DEFAULT_SPEED
        return self.limits.scaled(share, max(accel, LEAST_ACCELERATION))
