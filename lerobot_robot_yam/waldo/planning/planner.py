"""Planner of one arm: the only place where commands become motions, for dry run, simulator and real arm.

The planner reads no clock and no motor, so equal calls give equal plans. Impossible commands are refused before
anything moves.
"""

import math

import numpy as np

from lerobot_robot_yam.arm.collision.clearance import Clearance
from lerobot_robot_yam.arm.collision.parts import GuardedArm
from lerobot_robot_yam.arm.collision.workspace import WorkspaceConfig
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.errors import ConfigError, PlanError
from lerobot_robot_yam.waldo.planning import motion_plan
from lerobot_robot_yam.waldo.planning.line_motion import Line, joint_path, timed
from lerobot_robot_yam.waldo.planning.motion_plan import (
    HOME_RAD,
    STOP_FACTOR,
    Plan,
    joint_limits,
    overlap_s,
    sample_times,
    shares,
    standing,
    superposed,
)
from lerobot_robot_yam.waldo.planning.tool_kinematics import ToolKinematics
from lerobot_robot_yam.waldo.poses import numbers

_ROUNDING_RAD = 1e-4  # tolerance beyond a joint limit, rad: degrees in text are rounded
_SAME_M, _SAME_RAD = 1e-6, 1e-6  # length and rotation below which a line counts as a point, m and rad
_SAME_S = 1e-3  # braking time below which the arm counts as at rest, s
_RESTS_RAD_S = 1e-6
_SPEED_ROUNDING = 1.001
_LOOK_RAD = 0.05  # joint motion between two collision checks, rad; `Clearance` checks more densely near obstacles


class Planner:
    """Planner of an arm's motions. Not thread-safe.

    Angles are in rad, lengths in m. Poses (4, 4) are those of the tool's tip in the arm's base frame.

    Args:
        hardware: the arm.
        workspace: workspace limits; None: the workspace in the arm's config.

    Attributes:
        kinematics: kinematics of arm and tool, initially of the bare flange.
        lower, upper: (n,) limits of the joints.
        limits: motion limits of the joints.
        home_q: (n,) target of `home`.

    Raises:
        ConfigError: the arm does not have six joints, or its workspace is invalid.
    """

    def __init__(self, hardware: ResolvedArm, workspace: WorkspaceConfig | None = None):
        n = hardware.joints
        if n != len(HOME_RAD):
            raise ConfigError(f"{hardware.name}: Commander shows arms of six joints, and this one has {n}")
        self.hardware, self._names = hardware, hardware.joint_names
        self.kinematics = ToolKinematics(hardware.arm, hardware.gripper)
        self.lower, self.upper = self.kinematics.lower, self.kinematics.upper
        self.limits = joint_limits(hardware.speed_limit[:n])
        self.home_q = np.clip(HOME_RAD, self.lower, self.upper)
        self.keep_clear(hardware.config.workspace if workspace is None else workspace)

    def keep_clear(self, workspace: WorkspaceConfig) -> None:
        """Set the obstacles for subsequent plans: floor, boxes, and the arm itself with its gripper open.

        Raises:
            ConfigError: the workspace is invalid. The previous one is kept.
        """
        hardware = self.hardware
        guarded = GuardedArm(hardware.name, hardware.arm, hardware.gripper, workspace, hardware.tilt_rad)
        self._clearance = Clearance([guarded]) if workspace.limits_anything else None

    def conflict(self, q: np.ndarray) -> tuple[str, str] | None:
        """Return the names of the first two parts that come too close on a joint path (k, n), or None."""
        if self._clearance is None:
            return None
        kept = [0]
        for k in range(1, len(q)):
            if np.abs(q[k] - q[kept[-1]]).max() > _LOOK_RAD or k == len(q) - 1:
                kept.append(k)
        for before, after in zip(kept, kept[1:], strict=False):
            for found in self._clearance.conflicts(q[before], q[after]):
                names = self._clearance.parts.part_names
                return names[found.pair.first], names[found.pair.second]
        return None

    def _check_clear(self, q: np.ndarray) -> None:
        pair = self.conflict(q)
        if pair is not None:
            raise PlanError(
                f"{self.hardware.name}: on the way {pair[0]} would come too near to {pair[1]}; nothing moves"
            )

    def pose(self, q: np.ndarray) -> np.ndarray:
        """Return the poses (…, 4, 4) of the tool's tip for joints (…, n)."""
        return self.kinematics.pose(q)

    def inverse(self, pose: np.ndarray, near_q: np.ndarray, turn_over: bool = True) -> np.ndarray:
        """Return joints (n,) that bring the tool's tip to a pose, if possible near `near_q`.

        `turn_over`: whether to also search far from `near_q`.

        Raises:
            PlanError: the pose is out of reach.
        """
        found = self.kinematics.solve(pose, near_q, turn_over)
        if not found.converged:
            x, y, z = (1000.0 * pose[:3, 3]).tolist()
            raise PlanError(
                f"{self.hardware.name}: the tool cannot be put at x {x:.0f}, y {y:.0f}, z {z:.0f} mm with this "
                f"orientation; it comes to within {1000 * found.position_error_m:.1f} mm and "
                f"{math.degrees(found.orientation_error_rad):.1f}°"
            )
        return found.q

    def joints(
        self,
        start_q: np.ndarray,
        target_q: np.ndarray,
        *,
        speed: float = 0.0,
        accel: float = 1.0,
        duration: float | None = 0.0,
        start_dq: np.ndarray | None = None,
    ) -> Plan:
        """Plan a joint move. From rest, it is a straight line in joint space.

        Args:
            start_q: (n,) current set-point, rad.
            target_q: (n,) target joints, rad.
            speed, accel: fractions 0 … 1 of the limits; speed 0 means `motion_plan.DEFAULT_SPEED`.
            duration: required duration, s; if above 0, it replaces `speed`.
            start_dq: (n,) speed of the current set-point, rad/s; None: at rest.

        Raises:
            PlanError: the target is malformed or beyond a limit, or the move is too fast or blocked.
        """
        duration_s = duration or 0.0
        target, limits = self.within(target_q), self.limits.scaled(*shares(speed, accel, duration_s))
        resting = np.zeros(len(target))
        plan = motion_plan.move(start_q, resting if start_dq is None else start_dq, target, limits, duration_s)
        if start_dq is not None:  # a moving start may overshoot a limit
            self._check_range(plan, start_q)
        self._check_clear(plan.q)
        return plan

    def line(
        self,
        start_q: np.ndarray,
        target: np.ndarray,
        *,
        speed: float = 0.0,
        accel: float = 1.0,
        duration: float | None = 0.0,
    ) -> Plan:
        """Plan a move of the tool's tip, from rest, along a straight line with uniform rotation.

        Args:
            target: target pose (4, 4).
            speed, accel, duration: as for `joints`; the speed also scales the tool's limits.

        Raises:
            PlanError: the line leaves the reach or passes a singularity, or the move is malformed, too fast or blocked.
        """
        duration_s = duration or 0.0
        share = shares(speed, accel, duration_s)
        line = Line.between(self.pose(start_q), target)
        length, turn = line.size
        if length < _SAME_M and turn < _SAME_RAD:
            return standing(start_q)
        path = joint_path(self.kinematics, line, start_q, self._names)
        self._check_clear(path.q)
        return timed(path, line, self.limits, share, duration_s, self._names)

    def home(self, start_q: np.ndarray) -> Plan:
        """Plan a joint move to `home_q`, see `joints`."""
        return self.joints(start_q, self.home_q)

    def stop(self, q: np.ndarray, dq: np.ndarray) -> Plan:
        """Plan a stop from a set-point q (n,) that moves with dq (n,), rad/s. It brakes harder than a move does."""
        return motion_plan.brake(q, dq, STOP_FACTOR * self.limits.acceleration)

    def stop_on(self, plan: Plan, t_s: float) -> Plan:
        """Plan a stop on the path of a running plan, starting at time t_s of that plan.

        With T the braking time, the plan's time slows down as  τ = t + u − u² / 2T  and stands still after u = T.
        """
        q, dq = plan.at(t_s)
        lasts_s = float((np.abs(dq) / self.limits.acceleration).max())
        if lasts_s < _SAME_S:
            return standing(q)
        if t_s + lasts_s / 2.0 > plan.duration_s and np.abs(plan.dq[-1]).max() > _RESTS_RAD_S:
            return self.stop(q, dq)  # the path continues in another plan
        times = sample_times(lasts_s)
        way, speed = plan.at(t_s + times - times**2 / (2.0 * lasts_s))
        return Plan(times, way, speed * (1.0 - times / lasts_s)[:, None])

    def joined(self, first: Plan, second: Plan, radius_m: float) -> Plan:
        """Join two successive moves, rounding the corner between them within `radius_m`.

        If rounding would exceed a limit or come too close to an obstacle, the corner is rounded less or not at all.
        """
        overlap = overlap_s(first, second, self.pose, radius_m)
        for share in (1.0, 0.5, 0.25):
            plan = superposed(first, second, share * overlap)
            fast = np.abs(plan.dq).max(axis=0) > _SPEED_ROUNDING * self.limits.speed
            out = self._outside(plan.q).max() > max(self._outside(first.q[0]).max(), 0.0) + _ROUNDING_RAD
            if not fast.any() and not out and self.conflict(plan.q) is None:
                return plan
        return superposed(first, second, 0.0)

    def within(self, q: np.ndarray) -> np.ndarray:
        """Return `q` as an array (n,) of floats, clamped to the limits if only rounding errors exceed them.

        Raises:
            PlanError: `q` is malformed, or a joint is beyond its limit; the message names the joint.
        """
        given = numbers(f"{self.hardware.name}: a target, angles of joints,", q, len(self.lower))
        over = self._outside(given)
        worst = int(over.argmax())
        if over[worst] > _ROUNDING_RAD:
            low, high = np.degrees([self.lower[worst], self.upper[worst]])
            raise PlanError(
                f"{self.hardware.name}: {self._names[worst]} would be at {math.degrees(given[worst]):.2f}°, beyond its "
                f"limits {low:.2f}° … {high:.2f}°"
            )
        return np.clip(given, self.lower, self.upper)

    def _outside(self, q: np.ndarray) -> np.ndarray:
        """Return each joint's maximum excess (n,) over its range in q (…, n), rad; negative if within the range."""
        over = np.maximum(self.lower - q, q - self.upper)
        return over.reshape(-1, over.shape[-1]).max(axis=0)

    def _check_range(self, plan: Plan, start_q: np.ndarray) -> None:
        over = self._outside(plan.q)
        worst = int(over.argmax())
        if over[worst] > max(self._outside(start_q).max(), 0.0) + _ROUNDING_RAD:
            raise PlanError(
                f"{self.hardware.name}: {self._names[worst]} moves too fast to keep its limit on this way; stop first"
            )
