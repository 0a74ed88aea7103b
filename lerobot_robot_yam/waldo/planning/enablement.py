"""Which jog buttons can do something: +, − of each joint, and of each axis of a frame."""

import numpy as np

from lerobot_robot_yam.waldo.kinematics.frames import FRAMES, commanded
from lerobot_robot_yam.waldo.kinematics.inverse import Bounds, descend
from lerobot_robot_yam.waldo.planning.planner import Planner

_BAND_RAD = np.radians(1.0)  # a joint is at its limit when it is as near as this
_STEPS = np.array([5.0] * 3 + [1.0] * 3)  # mm and degrees, of a probe
_JUMP_RAD = 0.5  # a solution that is farther is another way of holding the tool


def joints_enabled(planner: Planner, q: np.ndarray) -> np.ndarray:
    """(2 n,) 1 or 0, int32: joint 1 upwards, joint 1 downwards, joint 2 upwards … at q (n,) rad."""
    ways = np.stack([q < planner.upper - _BAND_RAD, q > planner.lower + _BAND_RAD], axis=1)
    return ways.ravel().astype(np.int32)


def axes_enabled(planner: Planner, q: np.ndarray) -> dict[str, np.ndarray]:
    """By frame, (12,) 1 or 0, int32, X+ X− Y+ Y− … RZ−: whether the tool can go 5 mm or turn 1° that way from q."""
    now = planner.pose(q)
    steps = [sign * _STEPS * axis for axis in np.eye(6) for sign in (1.0, -1.0)]
    targets = np.array([commanded(now, step, frame, rel=True) for frame in FRAMES for step in steps])
    seeds = np.repeat(q[None], len(targets), axis=0)
    bounds = Bounds(np.minimum(planner.lower, q), np.maximum(planner.upper, q))
    found = descend(planner.chain, targets @ np.linalg.inv(planner.tool), seeds, bounds)
    free = found.reached & (np.abs(found.q - q).max(axis=1) < _JUMP_RAD)
    return dict(zip(FRAMES, free.astype(np.int32).reshape(len(FRAMES), -1), strict=True))
