"""Interface of a scripted operator to a live rig or to a faster simulation: sight, hands and clock."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import mujoco
import numpy as np


@dataclass(frozen=True)
class Pose:
    """Pose of a thing: origin (3,) and orientation (4,), w x y z, of the thing's frame in the world."""

    position_m: np.ndarray
    quat_wxyz: np.ndarray

    @property
    def rotation(self) -> np.ndarray:
        """Rotation matrix (3, 3)."""
        matrix = np.empty(9)
        mujoco.mju_quat2Mat(matrix, self.quat_wxyz)
        return matrix.reshape(3, 3)

    def point(self, local_m: np.ndarray) -> np.ndarray:
        """Transform a point (3,) from the thing's frame to the world frame."""
        return self.position_m + self.rotation @ local_m

    @property
    def yaw_rad(self) -> float:
        """Direction of the thing's x axis, seen from above, rad."""
        rotation = self.rotation
        return float(np.arctan2(rotation[1, 0], rotation[0, 0]))

    @property
    def edge_yaw_rad(self) -> float:
        """Direction of the axis nearest to horizontal, rad: an edge of a cube, whichever face it lies on."""
        axes = self.rotation
        level = axes[:, np.argmin(np.abs(axes[2]))]
        return float(np.arctan2(level[1], level[0]))


@dataclass(frozen=True)
class Sight:
    """State of the rig at one instant.

    Attributes:
        things: prop or piece of furniture → pose.
        joints: jointed furniture → position, m or rad.
        leader_rad, follower_rad: side → joints (n,); without leaders both hold the follower's joints.
        opening: side → opening of the follower's gripper, 0 … 1.
        willing: whether all arms are energised, and no arm has worked against the hand.
    """

    things: Mapping[str, Pose]
    joints: Mapping[str, float]
    leader_rad: Mapping[str, np.ndarray]
    follower_rad: Mapping[str, np.ndarray]
    opening: Mapping[str, float]
    willing: bool


def sight_of(state: Mapping[str, Any], sides: Iterable[str]) -> Sight:
    """Build the sight from a state as returned by `RigOperations.state`. sides: sides that have a follower."""
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


class Hands(Protocol):
    """Interface between scripts and rigs, implemented for the live rig, for lock-step and in tests."""

    def now(self) -> float: ...

    def wait(self, seconds: float) -> None: ...

    def look(self) -> Sight: ...

    def pull(self, side: str, times_s: np.ndarray, q_rad: np.ndarray, trigger: np.ndarray) -> None:
        """Pull a side's leader along joints (k, n) at times from now (k,), with trigger (k,), 0 … 1 (squeezed)."""

    def let_go(self) -> None: ...

    def put_back(self, position_m: np.ndarray) -> None: ...


class Interrupted(Exception):  # noqa: N818 - not an error: the session ended
    """Interruption of a script: the arms are switched off or resist the hand."""


def see(hands: Hands) -> Sight:
    """Return the current sight.

    Raises:
        Interrupted: an arm is switched off or resists the hand; the hands have released the leaders.
    """
    sight = hands.look()
    if not sight.willing:
        hands.let_go()
        raise Interrupted
    return sight


def pause(hands: Hands, seconds: float) -> Sight:
    """Wait, then return the sight; raises as `see` does."""
    hands.wait(max(0.0, seconds))
    return see(hands)
