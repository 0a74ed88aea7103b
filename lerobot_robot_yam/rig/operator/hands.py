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

    def seen_from(self, frame: "Pose") -> "Pose":
        """Return this pose in a frame that is given in the world."""
        back, quat = np.empty(4), np.empty(4)
        mujoco.mju_negQuat(back, frame.quat_wxyz)
        mujoco.mju_mulQuat(quat, back, self.quat_wxyz)
        return Pose(frame.rotation.T @ (self.position_m - frame.position_m), quat)

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
        things: prop or piece of furniture → pose in the world, or in the frame of the base's mount if there is a base.
        base: x, y, m, and heading, rad, of the base in the world, (3,); None without a base.
        joints: jointed furniture → position, m or rad.
        leader_rad, follower_rad: side → joints (n,); without leaders both hold the follower's joints.
        opening: side → opening of the follower's gripper, 0 … 1.
        willing: whether all arms are energised, and no arm has worked against the hand.
    """

    things: Mapping[str, Pose]
    base: np.ndarray | None
    joints: Mapping[str, float]
    leader_rad: Mapping[str, np.ndarray]
    follower_rad: Mapping[str, np.ndarray]
    opening: Mapping[str, float]
    willing: bool


def sight_of(state: Mapping[str, Any], sides: Iterable[str]) -> Sight:
    """Build the sight from a state as returned by `RigOperations.state`. sides: sides that have a follower."""
    arms, sides = state["arms"], tuple(sides)
    things = {name: _pose(thing) for name, thing in {**state["furniture"], **state["props"]}.items()}
    base = state.get("base")
    if base is not None:
        mount = _pose(base["mount"])
        things = {name: pose.seen_from(mount) for name, pose in things.items()}
    followers = {side: arms[f"follower_{side}"] for side in sides}
    leaders = {side: arms.get(f"leader_{side}", followers[side]) for side in sides}
    return Sight(
        things=things,
        base=None if base is None else np.array(base["pose"]),
        joints=dict(state["joints"]),
        leader_rad={side: np.array(arm["q"]) for side, arm in leaders.items()},
        follower_rad={side: np.array(arm["q"]) for side, arm in followers.items()},
        opening={side: float(arm["opening"]) for side, arm in followers.items()},
        willing=all(_willing(part) for part in (*leaders.values(), *followers.values(), *([base] if base else []))),
    )


def _pose(row: Mapping[str, Any]) -> Pose:
    return Pose(np.array(row["pos"]), np.array(row["quat"]))


def _willing(part: Mapping[str, Any]) -> bool:
    return not part.get("resists") and all(motor["enabled"] for motor in part["motors"].values())


class Hands(Protocol):
    """Interface between scripts and rigs, implemented for the live rig, for lock-step and in tests."""

    def now(self) -> float: ...

    def wait(self, seconds: float) -> None: ...

    def look(self) -> Sight: ...

    def pull(self, side: str, times_s: np.ndarray, q_rad: np.ndarray, trigger: np.ndarray) -> None:
        """Pull a side's leader along joints (k, n) at times from now (k,), with trigger (k,), 0 … 1 (squeezed)."""

    def drive(self, velocity: np.ndarray) -> None:
        """Ask for a velocity of the base (3,), m/s, m/s, rad/s, in its frame; must be repeated."""

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
