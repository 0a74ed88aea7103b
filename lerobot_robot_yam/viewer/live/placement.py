"""Where each arm stands in the scene: as its rig has it, else as its workspace says, else in a row."""

from collections.abc import Mapping

import numpy as np

from lerobot_robot_yam.arm.collision.workspace import WorkspaceConfig
from lerobot_robot_yam.arm.model import base_quat
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.viewer.live.rig_world import RigWorld
from lerobot_robot_yam.viewer.live.watched_arms import WatchedArm

Place = tuple[np.ndarray, np.ndarray]
"""Position (3,) m and orientation w x y z (4,) of a base."""
APART_M = 0.6  # of arms of which nobody says where they stand
RIGS_APART_M = 3.0


def places(arms: Mapping[str, WatchedArm], rigs: Mapping[str, RigWorld]) -> dict[str, Place]:
    """Of the base of each arm with a shape, by its key. Virtual rigs stand beside each other."""
    found: dict[str, Place] = {}
    unplaced = 0
    for key, arm in sorted(arms.items()):
        if arm.hardware is None:
            continue
        rig = rigs.get(arm.rig or "")
        known = None if rig is None else rig.base(arm.hardware.config.channel)
        if known is None:
            known = base_of(arm.hardware, unplaced)
            unplaced += not says_where(arm.hardware.config.workspace)
        elif rig is not None:
            known = known[0] + origin_of(list(rigs).index(rig.name)), known[1]
        found[key] = known
    return found


def origin_of(number: int) -> np.ndarray:
    """Where the world of the rig with that number, from 0, has its origin, (3,) m."""
    return np.array([0.0, -RIGS_APART_M * number, 0.0])


def says_where(workspace: WorkspaceConfig) -> bool:
    """Whether somebody has thought of the base's place: the defaults are that of any arm."""
    return workspace.limits_anything or any(workspace.base_position_m) or workspace.base_yaw_rad != 0.0


def base_of(hardware: ResolvedArm, number: int) -> Place:
    """Of an arm without a rig; `number`: how many before it stand in the row."""
    workspace = hardware.config.workspace
    position = np.array(workspace.base_position_m, dtype=float)
    if not says_where(workspace):
        position[1] = -APART_M * number
    return position, base_quat(workspace.base_yaw_rad, hardware.tilt_rad)
