"""What the motion commands of a program mean: degrees and millimetres in, plans out.

The dry run, the simulator and the real arm all plan here, so that a preview shows what will happen.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from lerobot_robot_yam.errors import PlanError
from lerobot_robot_yam.waldo.planning import rotation
from lerobot_robot_yam.waldo.planning.motion_plan import Plan, standing
from lerobot_robot_yam.waldo.planning.planner import Planner

WORLD, TOOL = "WRF", "TRF"
FRAMES = (WORLD, TOOL)
AXES = ("X", "Y", "Z", "RX", "RY", "RZ")
_MM = np.array([1e-3] * 3 + [np.pi / 180] * 3)  # to m and rad
_LONGEST_S = 600.0  # of a delay or a duration

Numbers = Sequence[float] | np.ndarray


class Pace(NamedTuple):
    """How fast: shares 0 … 1 of the limits, or a time in s that counts if it is above 0."""

    speed: float = 0.0
    accel: float = 1.0
    duration: float = 0.0


def move_j(
    planner: Planner, start_q: np.ndarray, angles: Numbers | None, pose: Numbers | None, pace: Pace, rel: bool
) -> Plan:
    """A move of the joints from start_q (n,) rad, to angles (deg) or to a pose of the tool (mm, deg).

    Raises:
        PlanError: neither or both are given, or see `Planner.joints`.
    """
    if (angles is None) == (pose is None):
        raise PlanError("move_j takes angles, or pose=, and not both")
    if pose is not None:
        target = planner.inverse(goal(planner, start_q, pose, WORLD, rel), start_q)
    else:
        target = np.radians(numbers("angles", angles, len(start_q))) + (start_q if rel else 0.0)
    speed, accel, duration = pace
    return planner.joints(start_q, target, speed=speed, accel=accel, duration_s=duration)


def move_l(planner: Planner, start_q: np.ndarray, pose: Numbers, frame: str, pace: Pace, rel: bool) -> Plan:
    """A straight line of the tool from start_q (n,) rad to a pose (mm, deg). Raises PlanError: see `Planner.line`."""
    speed, accel, duration = pace
    target = goal(planner, start_q, pose, frame, rel)
    return planner.line(start_q, target, speed=speed, accel=accel, duration_s=duration)


def goal(planner: Planner, start_q: np.ndarray, pose: Numbers, frame: str, rel: bool) -> np.ndarray:
    """The pose (4, 4) of the tool, m, that six numbers (mm, deg) mean for an arm at start_q (n,) rad.

    A relative pose in the world frame moves along and turns about the axes of the base, in place; one in the tool
    frame is a pose in that frame. An absolute pose is in the frame of the base.

    Raises:
        PlanError: malformed, or an absolute pose in another frame.
    """
    if frame not in FRAMES:
        raise PlanError(f"frame is one of {', '.join(FRAMES)}, not {frame!r}")
    given = rotation.of_vector(numbers("pose", pose, 6) * _MM)
    if not rel:
        if frame == TOOL:
            raise PlanError("an absolute pose is in WRF, the frame of the base; in TRF give rel=True")
        return given
    here = planner.pose(start_q)
    if frame == TOOL:
        return here @ given
    there = here.copy()
    there[:3, :3] = given[:3, :3] @ here[:3, :3]
    there[:3, 3] += given[:3, 3]
    return there


def pause(start_q: np.ndarray, seconds: float) -> Plan:
    """Standing still for a time. Raises PlanError: no time from 0 to 600 s."""
    (time_s,) = numbers("seconds", [seconds], 1)
    if not 0.0 <= time_s <= _LONGEST_S:
        raise PlanError(f"a delay takes 0 to {_LONGEST_S:g} s, not {seconds!r}")
    still = standing(start_q)
    return still if not time_s else still._replace(times_s=np.array([0.0, time_s]))


def shown(pose: np.ndarray) -> np.ndarray:
    """The six numbers, mm and deg, of poses (…, 4, 4) in m."""
    return rotation.to_vector(pose) / _MM


def numbers(what: str, values: object, count: int) -> np.ndarray:
    """`values` as (count,) finite floats. Raises PlanError: they are not."""
    try:
        given = np.array(values, dtype=float)
    except (TypeError, ValueError):
        given = np.zeros(0)
    if given.shape != (count,) or not np.isfinite(given).all():
        raise PlanError(f"{what} takes {count} finite numbers, not {values!r}")
    return given
