"""Matching of answers to the commands that they belong to.

An answer does not name its command. Three rules find the command, whatever time an adapter takes either way:

1. A motor answers in the order of its questions, so an answer belongs to the motor's oldest open question.
2. A wire keeps the order of ticks. Once a motor has answered tick k, answers that are owed for earlier ticks are lost.
3. A channel that has lost whole ticks looks like one that has become slow. So, when every motor has owed more than
   before for a while, the first motor is not asked for some ticks: if its answers end before all owed ones came, the
   rest is lost, and rule 2 gives up the others' owed answers. A single motor that owes more than the others is
   left out of one tick; rule 2 then gives up what it owes.

While a loss may be a delay, an answer counts for the older question, so that its sample may seem too old, but never too
new.
"""

import math
from collections import deque
from collections.abc import Iterable, Sequence

_OPEN_MAX = 128  # most open questions per motor: 0.5 s at 250 Hz; silence for so long is a fault
_BEHIND_TICKS = 2  # ticks in a row in which a motor owes more than the others before it is left out
_APART_TICKS, _APART_MAX_TICKS = 8, 128  # least and most ticks between two that leave out the same motor
_SLOW_TICKS = 50  # ticks in a row in which all owe more than before, until the first motor rests
_ENDED_TICKS = 4  # ticks in a row with answers of others only, after which the resting motor's have ended
_REST_TICKS = 30  # longest rest, ticks (0.12 s): a motor without commands lets go after 0.4 s


class Request:
    """Question to several motors.

    Attributes:
        number: number of the question, counted up.
        asked: number of motors that were asked.
        motors: indices of motors that have not answered.
        handle: whether the handle was asked and has not answered.
        sent_s: when the question was sent (the chain's clock).
        paced: whether there were pauses between the motors, so that `sent_s` holds for the first only.

    Args:
        patient: whether to wait for the handle, too.
    """

    __slots__ = ("_patient", "asked", "handle", "motors", "number", "paced", "sent_s")

    def __init__(self, number: int, motors: Iterable[int], handle: bool, patient: bool):
        self.number = number
        self.motors = set(motors)
        self.asked = len(self.motors)
        self.handle = handle
        self.sent_s = -math.inf
        self.paced = False
        self._patient = patient

    @property
    def missing(self) -> int:
        """Number of answers that are awaited."""
        return len(self.motors) + (self.handle and self._patient)


class Requests:
    """Open questions to `count` motors.

    Attributes:
        newest: the last question.
        heard: indices of motors that have answered since the caller last cleared the set.
        duplicates: per motor, number of answers to no question.
        lost: per motor, number of answers that never came.
    """

    def __init__(self, count: int):
        self.newest = Request(0, (), False, False)
        self.heard: set[int] = set()
        self.duplicates = [0] * count
        self.lost = [0] * count
        self._open: list[deque[Request]] = [deque() for _ in range(count)]
        self._answered = 0  # number of the newest question that any motor has answered
        self._handle_silent = False
        self._behind = [0] * count  # per motor: ticks in a row in which the motor owes more answers than others
        self._left_out = [0] * count  # number of the last question that left out this motor
        self._apart = [_APART_TICKS] * count
        self._usual = 0  # answers that every motor owes when asked again: more on a slow adapter
        self._slow_ticks = 0
        self._losses = 0  # losses of all motors, a tick ago
        # While the first motor rests (rule 3): what it owed a tick ago, the question that was answered then, for how
        # many ticks its answers have ended, and for how many it has not been asked.
        self._rest: tuple[int, int, int, int] | None = None
        self._losses_of_first = 0  # losses of the first motor before its rest

    def absent(self) -> Sequence[int]:
        """Return motors to leave out of the next tick, to learn whose answers come (rule 3)."""
        owed = [len(waiting) for waiting in self._open]
        if self._rest is not None:
            return [0] if self._go_on_resting(owed[0]) else ()
        if max(owed) == 0 == self._usual:  # nearly always
            self._slow_ticks = 0
            return ()
        number = self.newest.number + 1
        losses, self._losses = self._losses, sum(self.lost)
        if losses != self._losses:  # losses explain what is owed, and end without a rest
            self._slow_ticks = 0
        least = min(owed[1:] or owed)  # after a rest the first one owes less
        if len(owed) > 1:
            self._usual = min(self._usual, least)
        self._slow_ticks = self._slow_ticks + 1 if least > self._usual else 0
        absent = [i for i, count in enumerate(owed) if self._is_behind(i, count > least, number)]
        if self._slow_ticks < _SLOW_TICKS or absent:
            return absent
        self._slow_ticks, self._usual = 0, least
        self._rest, self._losses_of_first = (owed[0], self._answered, 0, 0), self.lost[0]
        return [0]

    def _go_on_resting(self, owed: int) -> bool:
        """Process a tick in which the first motor rested; return whether to leave it out of the next one, too."""
        assert self._rest is not None
        before, answered, ended, ticks = self._rest
        if owed != before:
            ended = 0
        elif self._answered != answered or len(self._open) == 1:
            ended += 1
        self._rest = owed, self._answered, ended, ticks + 1
        if ended == _ENDED_TICKS:
            self._give_up(0)
        if self._open[0] and ticks < _REST_TICKS:
            return True
        if self._open[0] or self.lost[0] > self._losses_of_first:  # else all its answers came, and the channel is slow
            self._usual = 0
        self._rest = None
        return False

    def _is_behind(self, motor: int, owes_more: bool, number: int) -> bool:
        """Return whether to leave out a motor that owes more than the others; less and less often if in vain."""
        if not owes_more:
            self._behind[motor] = 0
            if number - self._left_out[motor] > 2 * self._apart[motor]:
                self._apart[motor] = _APART_TICKS
            return False
        self._behind[motor] += 1
        if self._behind[motor] < _BEHIND_TICKS or number - self._left_out[motor] < self._apart[motor]:
            return False
        self._left_out[motor], self._behind[motor] = number, 0
        self._apart[motor] = min(2 * self._apart[motor], _APART_MAX_TICKS)
        return True

    def begin(self, motors: Iterable[int], handle: bool, repeats: int) -> Request:
        """Register a question that every motor answers `repeats` times."""
        asked = list(motors)
        # A silent handle must not delay every tick: its answer is awaited only while it answers.
        request = Request(self.newest.number + 1, asked, handle, not self._handle_silent)
        for i in asked:
            waiting = self._open[i]
            for _ in range(repeats):
                waiting.append(request)
            while len(waiting) > _OPEN_MAX:
                waiting.popleft()
                self.lost[i] += 1
        self.newest = request
        return request

    def answer(self, index: int) -> Request | None:
        """Note an answer of a motor; return its question, None when the motor was not asked. Hot: once per frame."""
        waiting = self._open[index]
        if not waiting:
            self.duplicates[index] += 1
            return None
        self.heard.add(index)
        request = waiting.popleft()
        if request.number > self._answered:  # the first answer to a question ends earlier ones (rule 2)
            self._answered = request.number
            for i, others in enumerate(self._open):
                while others and others[0].number < request.number:
                    others.popleft()
                    self.lost[i] += 1
        request.motors.discard(index)
        return request

    def withdraw(self) -> None:
        """Note that the newest question was not sent, or not to all motors."""
        for i, waiting in enumerate(self._open):
            if waiting and waiting[-1] is self.newest:
                waiting.pop()
                self.lost[i] += 1

    @property
    def owed(self) -> bool:
        """Whether any answer is still to come."""
        return any(self._open)

    def forget(self) -> None:
        """Count answers that have not come by now as lost."""
        for i in range(len(self._open)):
            self._give_up(i)

    def _give_up(self, motor: int) -> None:
        self.lost[motor] += len(self._open[motor])
        self._open[motor].clear()

    def handle_answer(self) -> None:
        """Note that the handle has answered."""
        self._handle_silent = False
        self.newest.handle = False

    def give_up_handle(self) -> bool:
        """Note that the handle has not answered in time; return whether it was asked."""
        silent = self.newest.handle
        self._handle_silent |= silent
        return silent
