"""What the motors of a chain have been asked, and whose answers are still to come."""

import math
from collections.abc import Iterable

_OUTSTANDING_MAX = 3  # per motor, answers that may still come; those beyond are duplicates
# Requests in a row that are sent ahead. Then the wire is left alone once: an answer to somebody else's question to the
# last motor looks like one to ours, and the true one would be taken for the next tick's from then on.
_AHEAD_MAX = 250


class Request:
    """Answers that are still to come to one request.

    Attributes:
        motors: by index, those that have not answered.
        handle: whether the handle was asked and has not answered.
        sent_s: when it had been sent (the chain's clock).

    Args:
        motors: by index, those that are asked.
        handle: whether the handle is.
        patient: whether it is waited for, too.
    """

    def __init__(self, motors: Iterable[int], handle: bool, patient: bool):
        self.motors = set(motors)
        self.handle = handle
        self.sent_s = -math.inf
        self._patient = patient

    @property
    def missing(self) -> int:
        """How many answers are waited for."""
        return len(self.motors) + (self.handle and self._patient)


class Requests:
    """The requests to `count` motors that have not been closed.

    Attributes:
        open: oldest first: one, or two where one was sent ahead.
        ahead: the next one will be.
        in_step: every answer has come that was waited for, and no other.
        duplicates: per motor, answers beyond those asked for.
    """

    def __init__(self, count: int):
        self.open: list[Request] = []
        self.ahead = self.in_step = False
        self.duplicates = [0] * count
        self._outstanding = [0] * count
        self._handle_silent = False
        self._ahead_in_a_row = 0

    def begin(self, motors: Iterable[int], handle: bool, repeats: int) -> None:
        """Open a request that every motor answers `repeats` times."""
        asked = list(motors)
        for i in asked:
            self._outstanding[i] = min(self._outstanding[i] + repeats, _OUTSTANDING_MAX)
        kept = self.open[-1:] if self.ahead else []
        dropped = self.open[: len(self.open) - len(kept)]  # as arms come up, or after an error
        self._ahead_in_a_row = self._ahead_in_a_row + 1 if self.ahead else 0
        self.in_step &= self._ahead_in_a_row < _AHEAD_MAX and not any(request.motors for request in dropped)
        self.open, self.ahead = kept, False
        # A silent handle must not hold up every tick: it is waited for only while it answers.
        self.open.append(Request(asked, handle, not self._handle_silent))

    def answer(self, index: int) -> None:
        """A motor has answered: the oldest request that has not heard of it. Hot: once per frame."""
        if self.open and index in self.open[0].motors:  # nearly always
            self.open[0].motors.remove(index)
        else:
            self.in_step = False
            for request in self.open[1:]:
                if index in request.motors:
                    request.motors.remove(index)
                    break
        if self._outstanding[index]:
            self._outstanding[index] -= 1
        else:
            self.duplicates[index] += 1

    def handle_answer(self) -> None:
        """The handle has."""
        self._handle_silent = False
        for request in self.open:
            request.handle = False

    def close(self) -> Request:
        """Close the oldest request, whatever is missing."""
        request = self.open.pop(0)
        self.in_step &= not request.motors
        self._handle_silent |= request.handle
        return request
