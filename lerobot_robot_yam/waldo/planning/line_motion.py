"""Straight line of the tool as a joint motion: first the joint path along the line, then its timing.

    p(s) = p0 + s Δp        R(s) = exp(s φ) R0        0 ≤ s ≤ 1,  φ the rotation vector from start to end

Inverse kinematics gives the joints at some values of s, each solution seeded from the previous one. In between, the
joints follow cubics through q and dq/ds = J⁻¹ (Δp, φ). The straightness is checked in the middle of each piece, and all
pieces are halved until all are straight. If halving does not help, or a joint would be too fast, the line passes a
singularity. Two arm configurations meet there, and the arm cannot continue at a finite speed.

At s, the joints move with speed q' ds/dt and acceleration q'' (ds/dt)² + q' d²s/dt². A line is followed at one
speed: the highest that the tool's limits allow, and that every joint can follow on the whole line.
"""

import math
from typing import NamedTuple

import numpy as np

from lerobot_robot_yam.arm.kinematics import pose_errors
from lerobot_robot_yam.arm.tool_pose import rotation_matrix, rotation_vector
from lerobot_robot_yam.errors import PlanError
from lerobot_robot_yam.waldo.planning import motion_plan
from lerobot_robot_yam.waldo.planning.motion_plan import (
    LINE_ACCELERATION_M_S2,
    LINE_ACCELERATION_RAD_S2,
    LINE_RAMP_S,
    LINE_SPEED_M_S,
    LINE_SPEED_RAD_S,
    Limits,
    Plan,
)
from lerobot_robot_yam.waldo.planning.tool_kinematics import ToolKinematics

STRAIGHT_M, STRAIGHT_RAD = 1e-4, 1e-3
"""Maximum error in the middle of a piece: a fifth of the promised 0.5 mm and 0.3°."""

_PIECE_M, _PIECE_RAD = 0.01, 0.05  # maximum length and rotation of a piece in the first division, m and rad
_DIVISIONS = 3  # maximum number of halvings
_AHEAD_RAD = 0.5  # maximum extrapolation of a joint from one piece to the next, rad
_AT_LIMIT_RAD = 1e-6
# Minimum fraction of the tool's full speed that the joint limits must allow. A line that allows less is too close to a
# singularity, and is refused.
_SLOWEST = 0.1
_TINY = 1e-9


class Line(NamedTuple):
    """Line from a tool pose (4, 4): translation (3,), m, and rotation vector (3,) in base axes, rad."""

    start: np.ndarray
    way: np.ndarray
    turn: np.ndarray

    @classmethod
    def between(cls, start: np.ndarray, end: np.ndarray) -> "Line":
        """Return the line between two poses (4, 4), with the smaller of the two possible rotations."""
        return cls(start, end[:3, 3] - start[:3, 3], rotation_vector(end[:3, :3] @ start[:3, :3].T))

    @property
    def size(self) -> tuple[float, float]:
        """Length, m, and rotation angle, rad."""
        return float(np.linalg.norm(self.way)), float(np.linalg.norm(self.turn))

    def at(self, share: float) -> np.ndarray:
        """Return the tool pose (4, 4) at a fraction of the line."""
        pose = self.start.copy()
        pose[:3, :3] = rotation_matrix(share * self.turn) @ self.start[:3, :3]
        pose[:3, 3] = self.start[:3, 3] + share * self.way
        return pose

    @property
    def twist(self) -> np.ndarray:
        """Derivative of the pose with respect to s (6,): translation, m, and rotation vector, rad."""
        return np.concatenate([self.way, self.turn])


def joint_path(arm: ToolKinematics, line: Line, start_q: np.ndarray, names: list[str]) -> Plan:
    """Return the joint path along a line, as a `Plan` whose times are the fractions s, 0 … 1.

    Args:
        start_q: joints (n,) at the line's start, rad. A joint outside its range may stay there or come back.
        names: names of the joints, for messages.

    Raises:
        PlanError: the line leaves the arm's reach or a joint's range, or passes a singularity.
    """
    length, turn = line.size
    pieces = max(math.ceil(length / _PIECE_M), math.ceil(turn / _PIECE_RAD), 2)
    for division in range(_DIVISIONS + 1):
        path = _divided(arm, line, start_q, names, pieces * 2**division)
        if _straight(arm, line, path):
            return path
    raise PlanError(
        "the line passes a singularity, where the arm cannot keep the tool on it; "
        "move the joints there instead (move_j)"
    )


def timed(
    path: Plan, line: Line, joints: Limits, share: tuple[float, float], duration_s: float, names: list[str]
) -> Plan:
    """Return the motion along a line, as fast as the limits of the tool and of each joint allow.

    Args:
        path: joint path along the line, see `joint_path`.
        joints: motion limits of the joints.
        share: fractions of the speed and acceleration limits to use.
        duration_s: required duration, s; 0: as short as the limits allow.
        names: names of the joints, for messages.

    Raises:
        PlanError: a joint would be too fast, or the motion takes longer than `duration_s`.
    """
    length, turn = (max(extent, _TINY) for extent in line.size)
    speed = min(LINE_SPEED_M_S / length, LINE_SPEED_RAD_S / turn)
    acceleration = share[1] * min(LINE_ACCELERATION_M_S2 / length, LINE_ACCELERATION_RAD_S2 / turn)
    rates = np.maximum(np.abs(path.dq).max(axis=0), _TINY)
    bends = np.maximum(np.abs(np.gradient(path.dq, path.times_s, axis=0)).max(axis=0), _TINY)
    allowed = np.minimum(joints.speed / rates, np.sqrt(0.5 * joints.acceleration / bends))
    slowest = int(allowed.argmin())
    if allowed[slowest] < _SLOWEST * speed:
        raise PlanError(
            f"the line passes so near to a singularity that {names[slowest]} would have to turn "
            f"{speed / allowed[slowest]:.0f} times faster than it may; move the joints there instead (move_j)"
        )
    acceleration = min(acceleration, share[1] * float((0.5 * joints.acceleration / rates).min()))
    limits = Limits(
        np.array([min(share[0] * speed, float(allowed.min()))]),
        np.array([acceleration]),
        np.array([acceleration / LINE_RAMP_S]),
    )
    way = motion_plan.move(np.zeros(1), np.zeros(1), np.ones(1), limits, duration_s)
    q, rate = path.at(way.q[:, 0])
    return Plan(way.times_s, q, rate * way.dq)


def _divided(arm: ToolKinematics, line: Line, start_q: np.ndarray, names: list[str], pieces: int) -> Plan:
    """Return the path through `pieces` equal pieces. If the joints jump, the path is not straight in between."""
    shares = np.linspace(0.0, 1.0, pieces + 1)
    q, rate = np.empty((2, pieces + 1, len(start_q)))
    q[0], rate[0] = start_q, arm.rates(start_q, line.twist)
    for k in range(1, pieces + 1):
        seed = q[k - 1] + np.clip(rate[k - 1] / pieces, -_AHEAD_RAD, _AHEAD_RAD)
        q[k], reached = arm.follow(line.at(shares[k]), start_q, seed)
        if not reached:
            raise PlanError(_why_not(arm, q[k], names, shares[k]))
        rate[k] = arm.rates(q[k], line.twist)
    return Plan(shares, q, rate)


def _straight(arm: ToolKinematics, line: Line, path: Plan) -> bool:
    middles = (path.times_s[:-1] + path.times_s[1:]) / 2
    for pose, share in zip(arm.pose(path.at(middles)[0]), middles.tolist(), strict=True):
        off_m, turned_rad = pose_errors(pose, line.at(share))
        if off_m > STRAIGHT_M or turned_rad > STRAIGHT_RAD:
            return False
    return True


def _why_not(arm: ToolKinematics, q: np.ndarray, names: list[str], share: float) -> str:
    """Return why no solution was found. q (n,), rad, is the closest attempt."""
    room = np.minimum(q - arm.lower, arm.upper - q)
    where = f"at {100 * share:.0f} % of the line"
    stopped = [f"{names[i]} at {math.degrees(q[i]):.1f}°" for i in np.flatnonzero(room <= _AT_LIMIT_RAD).tolist()]
    if stopped:
        return f"{where} the tool would be out of reach: {', '.join(stopped)} would pass its limit"
    return f"{where} the tool would be out of reach, or the arm in a singularity (stretched out)"
