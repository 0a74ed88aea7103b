"""Requests of a page to the LeRobot command in this process, and the objects that carry them out."""

from typing import NamedTuple, Protocol

from lerobot_robot_yam.face.lerobot_command.running_command import Meaning, Situation


class Press(NamedTuple):
    """A press of a button, or a request in its place.

    Attributes:
        by: the button, or the page's name.
        meaning: the requested thing.
        turn: the run of the command's loop that it is for; None for any.
    """

    by: str
    meaning: Meaning
    turn: float | None = None


class Doer(Protocol):
    """Object that carries out requests."""

    def ask(self, press: Press) -> None:
        """Carry out a press. Any thread may call it."""

    def offers(self, now: Situation, first: int) -> dict[str, str]:
        """Describe in words what each meaning would do now; first: episodes before this session."""


_doers: list[Doer] = []


def join(doer: Doer, first: bool) -> None:
    """Register a doer; first: before all others."""
    _doers.insert(0 if first else len(_doers), doer)


def leave(doer: Doer) -> None:
    """Remove a doer. Idempotent."""
    if doer in _doers:
        _doers.remove(doer)


def ask(press: Press) -> bool:
    """Pass a press to the first doer; return False without one."""
    for doer in _doers:
        doer.ask(press)
        return True
    return False


def offers(now: Situation, first: int) -> dict[str, str]:
    return next((doer.offers(now, first) for doer in _doers), {})
