"""What a page asks of the LeRobot command in this process, and who can do it."""

from typing import NamedTuple, Protocol

from lerobot_robot_yam.face.lerobot_command.running_command import Meaning, Situation


class Press(NamedTuple):
    """A press of a button, or a request as if it were one.

    Attributes:
        by: the button, or who asks.
        meaning: what it asks for.
        turn: the run of the command's loop that it is for; None: whichever.
    """

    by: str
    meaning: Meaning
    turn: float | None = None


class Doer(Protocol):
    """Who can do what is asked for."""

    def ask(self, press: Press) -> None:
        """As if a button had been pressed. Any thread may ask."""

    def offers(self, now: Situation, first: int) -> dict[str, str]:
        """Say in words what each meaning would do now; `first`: episodes before this session."""


_doers: list[Doer] = []


def join(doer: Doer, first: bool) -> None:
    """Be asked from now on; `first`: before all others."""
    _doers.insert(0 if first else len(_doers), doer)


def leave(doer: Doer) -> None:
    """Be asked no more. Idempotent."""
    if doer in _doers:
        _doers.remove(doer)


def ask(press: Press) -> bool:
    """Have something done; False: the command can be asked for nothing."""
    for doer in _doers:
        doer.ask(press)
        return True
    return False


def offers(now: Situation, first: int) -> dict[str, str]:
    """What can be asked for now, see `Doer.offers`."""
    return next((doer.offers(now, first) for doer in _doers), {})
