"""Why the control loop's collision guard holds a set-point back: the parts on the way to the goal that are too near.

The loop says only that it does. The same check, of a short piece of the way ahead, names the parts.
"""

from collections.abc import Sequence

import numpy as np

from lerobot_robot_yam.arm.collision.clearance import Clearance
from lerobot_robot_yam.arm.collision.parts import GuardedArm
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm

_AHEAD_RAD = 0.05  # the guard stops this near to its limit, or nearer


class HeldBack:
    """Of all arms of one session. One thread uses it.

    Args:
        arms: in the order of all lists below.
    """

    def __init__(self, arms: Sequence[ResolvedArm]):
        self._joints = [arm.joints for arm in arms]
        self._clearance = Clearance(
            [GuardedArm(arm.name, arm.arm, arm.gripper, arm.config.workspace, arm.tilt_rad) for arm in arms]
        )

    def reason(
        self, arm: int, setpoints: Sequence[np.ndarray], goals: Sequence[np.ndarray], openings: Sequence[float]
    ) -> str:
        """The parts that hold this arm back: "left link4 – left link1, 21 mm"; empty when there are none.

        Args:
            arm: its index.
            setpoints, goals: per arm (joints,) or more, rad: where it is asked to be, and where it is to go.
            openings: per arm, of its gripper, 0 closed … 1 open.
        """
        parts = self._clearance.parts
        parts.open_grippers(openings)
        start, goal = (
            np.concatenate([row[:n] for row, n in zip(rows, self._joints, strict=True)]) for rows in (setpoints, goals)
        )
        way = goal - start
        way *= min(1.0, _AHEAD_RAD / max(float(np.abs(way).max(initial=0.0)), 1e-9))
        found: dict[str, None] = {}
        for conflict in self._clearance.conflicts(start, start + way):
            if arm in conflict.pair.arms:
                first, second = (parts.part_names[part] for part in conflict.pair[:2])
                found.setdefault(f"{first} – {second}, {conflict.before_m * 1000:.0f} mm")
        return "; ".join(found)
