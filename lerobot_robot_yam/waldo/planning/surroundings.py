"""What an arm keeps away from, for a whole motion before it starts; the rule is `arm.collision.clearance`'s."""

import numpy as np

from lerobot_robot_yam.arm.collision.clearance import Clearance
from lerobot_robot_yam.arm.collision.parts import GuardedArm
from lerobot_robot_yam.arm.collision.workspace import WorkspaceConfig
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.errors import PlanError

_LOOK_RAD = 0.05  # joint motion between two looks; `Clearance` looks in between where something is near


class Surroundings:
    """Floor, boxes and the arm itself, the gripper open.

    Args:
        hardware: the arm.
        workspace: its limits in space.

    Raises:
        ConfigError: a workspace that cannot be used.
    """

    def __init__(self, hardware: ResolvedArm, workspace: WorkspaceConfig):
        self._name = hardware.name
        guarded = GuardedArm(hardware.name, hardware.arm, hardware.gripper, workspace, hardware.tilt_rad)
        self._clearance = Clearance([guarded]) if workspace.limits_anything else None

    def check(self, q: np.ndarray) -> None:
        """Raises PlanError, naming the two parts, if a way through joints (k, n) rad brings them too near."""
        pair = self.first_conflict(q)
        if pair is not None:
            raise PlanError(f"{self._name}: on the way {pair[0]} would come too near to {pair[1]}; nothing moves")

    def first_conflict(self, q: np.ndarray) -> tuple[str, str] | None:
        """Names of the two parts that a way through joints (k, n) rad brings too near first; None: it is clear."""
        if self._clearance is None:
            return None
        kept = [0]
        for k in range(1, len(q)):
            if np.abs(q[k] - q[kept[-1]]).max() > _LOOK_RAD or k == len(q) - 1:
                kept.append(k)
        for before, after in zip(kept, kept[1:], strict=False):
            for conflict in self._clearance.conflicts(q[before], q[after]):
                names = self._clearance.parts.part_names
                return names[conflict.pair.first], names[conflict.pair.second]
        return None
