"""A scripted operator's view of the rig."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np


@dataclass(frozen=True)
class Pose:
    """Where a thing is: origin (3,) and orientation (4,), w x y z, of its frame in the world."""

    position_m: np.ndarray
    quat_wxyz: np.ndarray

    @property
    def rotation(self) -> np.ndarray:
        """(3, 3)."""
        matrix = np.empty(9)
        mujoco.mju_quat2Mat(matrix, self.quat_wxyz)
        return matrix.reshape(3, 3)

    def point(self, local_m: np.ndarray) -> np.ndarray:
        """A point (3,) of its frame, in the world."""
        return self.position_m + self.rotation @ local_m

    @property
    def yaw_rad(self) -> float:
        """Direction of its x axis, seen from above."""
        rotation = self.rotation
        return float(np.arctan2(rotation[1, 0], rotation[0, 0]))

    @property
    def edge_yaw_rad(self) -> float:
        """Direction of its most level axis: of a cube's edge, whichever face it lies on."""
        axes = self.rotation
        level = axes[:, np.argmin(np.abs(axes[2]))]
        return float(np.arctan2(level[1], level[0]))


@dataclass(frozen=True)
class Sight:
    """One look.

    Attributes:
        things: prop or piece of furniture → its pose.
        joints: jointed furniture → position, m or rad.
        leader_rad, follower_rad: side → joints (n,); without leaders both are the follower's.
        opening: side → opening of the follower's gripper, 0 … 1.
        willing: all arms are energised, and no arm has worked against the hand.
    """

    things: Mapping[str, Pose]
    joints: Mapping[str, float]
    leader_rad: Mapping[str, np.ndarray]
    follower_rad: Mapping[str, np.ndarray]
    opening: Mapping[str, float]
    willing: bool


def sight_of(state: Mapping[str, Any], sides: Iterable[str]) -> Sight:
    """The view of a state as `RigOperations.state` returns it; `sides` are those that have a follower."""
    arms, sides = state["arms"], tuple(sides)
    things = {**state["furniture"], **state["props"]}
    followers = {side: arms[f"follower_{side}"] for side in sides}
    leaders = {side: arms.get(f"leader_{side}", followers[side]) for side in sides}
    return Sight(
        things={name: Pose(np.array(thing["pos"]), np.array(thing["quat"])) for name, thing in things.items()},
        joints=dict(state["joints"]),
        leader_rad={side: np.array(arm["q"]) for side, arm in leaders.items()},
        follower_rad={side: np.array(arm["q"]) for side, arm in followers.items()},
        opening={side: float(arm["opening"]) for side, arm in followers.items()},
        willing=all(_willing(arm) for arm in (*leaders.values(), *followers.values())),
    )


def _willing(arm: Mapping[str, Any]) -> bool:
    return not arm["resists"] and all(motor["enabled"] for motor in arm["motors"].values())
