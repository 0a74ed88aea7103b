"""Base poses of the arms in the scene, from the rig or else from the workspace. No two arms get the same position.

An arm that is driven by the process of a mobile base rides on its mount.
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping

import numpy as np

from lerobot_robot_yam.arm.model import base_quat
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.doctor.kit.targets import LEADER_GRIPPER
from lerobot_robot_yam.viewer.figure import Place, on
from lerobot_robot_yam.viewer.live.rig_world import RigWorld
from lerobot_robot_yam.viewer.live.watched_arms import WatchedArm

APART_M = 0.6  # distance between arms without a configured position, m: otherwise all would be drawn at the origin
RIGS_APART_M = 3.0
_SAME_M = 0.1


def places(
    arms: Mapping[str, WatchedArm], rigs: Mapping[str, RigWorld], mounts: Mapping[str, Place]
) -> dict[str, Place]:
    """Return channel key → base pose for each arm whose hardware is known. Virtual rigs are drawn side by side.

    mounts: process → place of the mount of the mobile base that it drives.
    """
    found: dict[str, Place] = {}
    riders: dict[str, list[Place]] = defaultdict(list)  # process → places on its mount
    for key, arm in sorted(arms.items()):
        if arm.hardware is None:
            continue
        rig = rigs.get(arm.rig or "")
        base = None if rig is None else rig.base(arm.hardware.config.channel)
        if rig is not None and base is not None:
            found[key] = base[0] + origin_of(list(rigs).index(rig.name)), base[1]
            continue
        if (mount := mount_of(arm, mounts)) is not None:
            riders[arm.process].append(place := clear_of(riders[arm.process], base_of(arm.hardware)))
            found[key] = on(mount, place)
            continue
        found[key] = clear_of(found.values(), base_of(arm.hardware))
    return found


def mount_of(arm: WatchedArm, mounts: Mapping[str, Place]) -> Place | None:
    """Return the place of the mount on which an arm rides, or None. A leader rides on none."""
    if arm.hardware is None or arm.hardware.config.gripper == LEADER_GRIPPER:
        return None
    return mounts.get(arm.process)


def row_of(arms: Iterable[ResolvedArm]) -> list[Place]:
    """Return base poses for arms that belong to no rig, computed as in `places`."""
    found: list[Place] = []
    for hardware in arms:
        found.append(clear_of(found, base_of(hardware)))
    return found


def clear_of(taken: Iterable[Place], place: Place) -> Place:
    """Return `place`, or if another arm is there, the next free position beside it."""
    position, quat = place[0].copy(), place[1]
    others = [other for other, _ in taken]
    while any(np.linalg.norm(position - other) < _SAME_M for other in others):
        position[1] -= APART_M
    return position, quat


def origin_of(number: int) -> np.ndarray:
    """Return the world origin (3,), m, of the rig with index `number` (from 0)."""
    return np.array([0.0, -RIGS_APART_M * number, 0.0])


def base_of(hardware: ResolvedArm) -> Place:
    """Return the base pose given by an arm's workspace config."""
    workspace = hardware.config.workspace
    return np.array(workspace.base_position_m, dtype=float), base_quat(workspace.base_yaw_rad, hardware.tilt_rad)
