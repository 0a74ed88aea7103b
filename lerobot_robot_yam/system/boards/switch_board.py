"""Boards that read the two switches of an axis and drive its brake: what each driver does."""

import math
from typing import NamedTuple, Protocol


class BoardSample(NamedTuple):
    """What a driver has read last.

    Attributes:
        upper, lower: whether the switch is triggered. An open wire reads so, since inputs are pulled up.
        brake_on: whether the brake's output is confirmed to engage it; None: not confirmed yet.
        stamp_s: time of the reading, on the clock of the base's channel; -inf before the first.
    """

    upper: bool
    lower: bool
    brake_on: bool | None
    stamp_s: float


class SwitchBoard(Protocol):
    """Driver of one board. No call blocks; the brake is engaged once the driver is open."""

    def read(self) -> BoardSample:
        """Return the newest sample."""

    def set_brake(self, on: bool) -> None:
        """Engage or release the brake; a sample confirms it."""

    def close(self) -> None:
        """Release what the driver has opened. Idempotent."""


class LostBoard:
    """Driver that is not open: it never has a sample, so the motor goes on holding."""

    def read(self) -> BoardSample:
        return BoardSample(False, False, None, -math.inf)

    def set_brake(self, on: bool) -> None:
        pass

    def close(self) -> None:
        pass
