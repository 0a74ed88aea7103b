"""What the control loop needs of each part of a robot: an arm, or a mobile base."""

from collections.abc import Iterator
from typing import Protocol

from lerobot_robot_yam.control.arm_status import ArmStatus
from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.system.clock import Clock


class Controller(Protocol):
    """Controller of the motors of one channel. `loop` documents the order of the calls in a tick."""

    name: str
    status: ArmStatus

    @property
    def mode(self) -> Mode:
        """The present mode; `status` has the rest."""

    @property
    def clock(self) -> Clock:
        """Clock of the channel."""

    @property
    def wire_s(self) -> float:
        """Time that the frames of one tick take on the wire, s."""

    @property
    def lost(self) -> int:
        """Number of replies that never came."""

    def energise(self) -> Iterator[None]:
        """Enable the motors, one step per tick. Raises YamError: a motor does not enable; abandon this part."""

    def start_send(self) -> None:
        """Send the commands of a tick of the start. Raises BusError: the channel does not take the frames."""

    def start_receive(self, until_s: float) -> None:
        """Process the replies to `start_send`. Raises BusError: the channel is gone."""

    def abandon(self) -> None:
        """Cut torque during bring-up, over the next ticks."""

    def end(self, now: float) -> None:
        """Begin the way to OFF; called at each tick once the loop has to end."""

    def send(self) -> None:
        """Send the commands of this tick."""

    def drain(self) -> None:
        """Process the replies that have arrived, without waiting."""

    def collect(self, until_s: float) -> None:
        """Process the replies to this tick's commands; wait for late ones until `until_s`."""

    def measure(self, now: float) -> None:
        """Update the state from the replies; respond to faults."""

    def stop_reason(self, now: float) -> str:
        """Return why everything has to stop; empty if nothing has to."""

    def decide(self, now: float) -> None:
        """Decide on the mode and the goal."""

    def advance(self, now: float, dt: float) -> None:
        """Step the set-point or plan by `dt` seconds."""

    def compute_command(self, now: float, dt: float) -> None:
        """Compute the commands of the next `send`."""

    def fail(self, error: Exception) -> None:
        """Respond to an exception in our own code: stay commanded."""

    def take_news(self) -> Trouble | None:
        """Return the fault that has come up since the last call."""

    def halt(self, peer: ArmStatus) -> None:
        """Hold, because another part of the robot has a fault."""

    def close(self) -> None:
        """Close what this controller has opened itself; the bus is the caller's. Idempotent."""

    def complaints(self) -> list[str]:
        """Return warnings about adapter and cable for the end of the session."""


class Blocks(Protocol):
    """Connection of one controller with its two shared blocks."""

    published_mode: Mode

    @property
    def owned(self) -> bool:
        """False once another loop has taken the part over."""

    def publish(self, now: float, tick: int) -> None:
        """Write the state of this tick."""

    def read_target(self, now: float) -> None:
        """Pass on what the caller has written since the last tick."""

    def close(self, remove: bool) -> None:
        """Close both blocks; `remove` hides the states."""
