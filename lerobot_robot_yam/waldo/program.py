"""Translation of a program's commands, given in degrees and millimetres, into plans.

Dry run, simulator and real arm all plan with these functions, so that a preview shows the real motion.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from lerobot_robot_yam.arm.profile import GripperProfile
from lerobot_robot_yam.errors import PlanError
from lerobot_robot_yam.waldo.arm_choice import NO_TOOL, tool_key
from lerobot_robot_yam.waldo.planning.motion_plan import Plan, standing
from lerobot_robot_yam.waldo.planning.planner import Planner
from lerobot_robot_yam.waldo.poses import Numbers, commanded, numbers

PROFILES = ("ruckig",)
"""Motion profiles. The only one limits speed, acceleration and jerk."""

_LONGEST_S = 600.0  # maximum pause, s
_ACTIONS = {"open": 0.0, "close": 1.0}  # gripper action → position, 0 open … 1 closed as in Commander


def move_j(
    planner: Planner,
    start_q: np.ndarray,
    angles: Numbers | None = None,
    pose: Numbers | None = None,
    *,
    rel: bool = False,
    **pace: Any,
) -> Plan:
    """Plan a joint move from start_q (n,), rad, to joint angles (deg) or to a tool pose (mm, deg).

    Args:
        rel: whether `angles` or `pose` are relative to the start.
        pace: speed, accel, duration; see `Planner.joints`.

    Raises:
        PlanError: neither or both of `angles` and `pose` are given, or `Planner.joints` raises it.
    """
    if (angles is None) == (pose is None):
        raise PlanError("move_j takes angles, or pose=, and not both")
    if pose is not None:
        target = planner.inverse(commanded(planner.pose(start_q), pose, rel=rel), start_q)
    else:
        target = np.radians(numbers("angles", angles, len(start_q))) + (start_q if rel else 0.0)
    return planner.joints(start_q, target, **pace)


def move_l(
    planner: Planner, start_q: np.ndarray, pose: Numbers, *, frame: str = "WRF", rel: bool = False, **pace: Any
) -> Plan:
    """Plan a straight tool move from start_q (n,), rad, to a pose (mm, deg). Other arguments as for `move_j`.

    Raises:
        PlanError: the pose or frame is malformed, or `Planner.line` raises it.
    """
    return planner.line(start_q, commanded(planner.pose(start_q), pose, frame, rel), **pace)


def pause(start_q: np.ndarray, seconds: float) -> Plan:
    """Plan a pause at start_q (n,), rad. Raises PlanError: `seconds` is not within 0 … 600."""
    (time_s,) = numbers("seconds", [seconds], 1)
    if not 0.0 <= time_s <= _LONGEST_S:
        raise PlanError(f"a delay takes 0 to {_LONGEST_S:g} s, not {seconds!r}")
    still = standing(start_q)
    return still if not time_s else still._replace(times_s=np.array([0.0, time_s]))


def radius(r: float) -> float:
    """Convert a blend radius from mm to m. Raises PlanError: `r` is negative or not a number."""
    (given,) = numbers("r", [r or 0.0], 1).tolist()
    if given < 0.0:
        raise PlanError(f"r, a radius in mm, is 0 or more, not {r!r}")
    return 1e-3 * float(given)


def jaw_position(gripper: GripperProfile, key: str, action: str, params: Sequence[float] | None) -> float:
    """Return the jaw target of a gripper action, 0 open … 1 closed.

    Raises:
        PlanError: the tool or the action is unknown, or the position is malformed.
    """
    fitted = tool_key(gripper)
    if key != fitted or fitted == NO_TOOL:
        raise PlanError(f"no tool {key!r} that moves; this arm has {fitted}")
    if action in _ACTIONS:
        return _ACTIONS[action]
    if action != "move":
        raise PlanError(f"{key}: an action is open, close or move, not {action!r}")
    (position,) = numbers("position", params, 1)
    if not 0.0 <= position <= 1.0:
        raise PlanError(f"{key}: a position is 0 (open) to 1 (closed), not {position:g}")
    return float(position)


def swapped(position: float) -> float:
    """Convert a gripper position between Commander's (0 open … 1 closed) and ours (0 closed … 1 open).

    This is the only place in the code with this conversion.
    """
    return 1.0 - position
