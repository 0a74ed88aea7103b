"""Requests from a page to the LeRobot command in this process, and the objects that carry them out."""

from typing import NamedTuple, Protocol

from lerobot_robot_yam.face.lerobot_command.running_command import Meaning, Situation


class Press(NamedTuple):
    """Request of a button press or of a page.

    Attributes:
        by: name of the button or page.
        meaning: requested action of the command.
        turn: run of the command's loop for which the request is valid; None: any run.
    """

    by: str
    meaning: Meaning
    turn: float | None = None


class Doer(Protocol):
    """Object that carries out requests."""

    def ask(self, press: Press) -> None:
        """Carry out a request. Any thread may call this method."""

    def offers(self, now: Situation, first: int) -> dict[str, str]:
        """Return meaning → description of its current effect. first: number of episodes before this session."""


_doers: list[Doer] = []


def join(doer: Doer, first: bool) -> None:
    """Register an object that carries out requests. first: whether this object has priority over all others."""
    _doers.insert(0 if first else len(_doers), doer)


def leave(doer: Doer) -> None:
    """Remove an object that `join` has registered. Idempotent."""
    if doer in _doers:
        _doers.remove(doer)


def ask(press: Press) -> bool:
    """Pass a request to the registered object with the highest priority. Return False if none is registered."""
    for doer in _doers:
        doer.ask(press)
        return True
    return False


def offers(now: Situation, first: int) -> dict[str, str]:
    return next((doer.offers(now, first) for doer in _doers), {})
