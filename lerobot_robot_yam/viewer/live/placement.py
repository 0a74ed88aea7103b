"""Places of the arms in the scene: from the rig, or else from the workspace; no two arms have the same place."""

from collections.abc import Iterable, Mapping

import numpy as np

from lerobot_robot_yam.arm.model import base_quat
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.viewer.live.rig_world import RigWorld
from lerobot_robot_yam.viewer.live.watched_arms import WatchedArm

Place = tuple[np.ndarray, np.ndarray]
"""Position (3,) m and orientation w x y z (4,) of a base."""
APART_M = 0.6  # distance between arms without a place, m: without it, all would be at the origin
RIGS_APART_M = 3.0
_SAME_M = 0.1


def places(arms: Mapping[str, WatchedArm], rigs: Mapping[str, RigWorld]) -> dict[str, Place]:
    """Return channel key → place of the base, for each arm with a shape. Virtual rigs stand beside each other."""
    found: dict[str, Place] = {}
    for key, arm in sorted(arms.items()):
        if arm.hardware is None:
            continue
        rig = rigs.get(arm.rig or "")
        base = None if rig is None else rig.base(arm.hardware.config.channel)
        if rig is not None and base is not None:
            found[key] = base[0] + origin_of(list(rigs).index(rig.name)), base[1]
            continue
        found[key] = clear_of(found.values(), base_of(arm.hardware))
    return found


def row_of(arms: Iterable[ResolvedArm]) -> list[Place]:
    """Return the places of arms that belong to no rig, as `places` does."""
    found: list[Place] = []
    for hardware in arms:
        found.append(clear_of(found, base_of(hardware)))
    return found


def clear_of(taken: Iterable[Place], place: Place) -> Place:
    """Return the place if no other arm is there, or else the next free place beside it."""
    position, quat = place[0].copy(), place[1]
    others = [other for other, _ in taken]
    while any(np.linalg.norm(position - other) < _SAME_M for other in others):
        position[1] -= APART_M
    return position, quat


def origin_of(number: int) -> np.ndarray:
    """Return the origin (3,), m, of the world of the rig with this number (from 0)."""
    return np.array([0.0, -RIGS_APART_M * number, 0.0])


def base_of(hardware: ResolvedArm) -> Place:
    """Return the place of an arm's base from the arm's workspace."""
    workspace = hardware.config.workspace
    return np.array(workspace.base_position_m, dtype=float), base_quat(workspace.base_yaw_rad, hardware.tilt_rad)
