"""What sends a recorded motion to arms: the one thing that the page's data part asks of whoever drives them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.session.trajectory import Trajectory


@dataclass(frozen=True)
class ReplayState:
    """How a replay stands.

    Attributes:
        running: whether it is under way, paused or not.
        paused: whether it stands still, or is about to.
        energised: whether the arms have torque from us.
        share: how much of it is done, 0 … 1, the approach included.
        text: what there is to say, such as why it has ended.
    """

    running: bool = False
    paused: bool = False
    energised: bool = False
    share: float = 0.0
    text: str = ""


class Driver(Protocol):
    """Drives arms. Every call returns at once; `state` tells what has become of it."""

    @property
    def arms(self) -> Mapping[str, ResolvedArm]:
        """The arms by the prefix of their values in data sets: "", or "left_" and "right_"."""

    def replay(self, trajectories: Mapping[str, Trajectory]) -> None:
        """Energise the arms if they are not, go softly to the first pose, then along the trajectories of equal times.

        Args:
            trajectories: by prefix, one for each arm.

        Raises:
            ActionError: they do not fit the arms; nothing moves.
            LifeCycleError: a replay is under way.
        """

    def pause(self) -> None:
        """Come to rest softly on the way, and hold there."""

    def resume(self) -> None:
        """Go on."""

    def end(self) -> None:
        """End the replay; the arms hold where they are."""

    def land(self) -> None:
        """End the replay, and land the arms."""

    @property
    def state(self) -> ReplayState:
        """How it stands."""

    def close(self) -> None:
        """Land the arms and let go of them; waits for it. Idempotent."""
