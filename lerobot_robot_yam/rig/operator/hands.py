"""A scripted operator's eyes, hands and clock: those of a live rig, or of a simulation that runs faster than time."""

from typing import Protocol

import numpy as np

from lerobot_robot_yam.rig.operator.sight import Sight


class Hands(Protocol):
    """Implemented for the live rig, in lock-step, and in tests."""

    def now(self) -> float: ...

    def wait(self, seconds: float) -> None: ...

    def look(self) -> Sight: ...

    def pull(self, side: str, times_s: np.ndarray, q_rad: np.ndarray, trigger: np.ndarray) -> None:
        """Pull the leader of a side along (k, n) joints at times from now (k,), with trigger 0 … 1 (squeezed) (k,)."""

    def let_go(self) -> None: ...

    def put_back(self, position_m: np.ndarray) -> None: ...


class Interrupted(Exception):  # noqa: N818 - not an error: the session ended
    """The arms are switched off, or go their own way."""


def see(hands: Hands) -> Sight:
    """Look.

    Raises:
        Interrupted: the arms are switched off, or have begun to go their own way. The hands have let go.
    """
    sight = hands.look()
    if not sight.willing:
        hands.let_go()
        raise Interrupted
    return sight


def pause(hands: Hands, seconds: float) -> Sight:
    """Wait, then look, see `see`."""
    hands.wait(max(0.0, seconds))
    return see(hands)
