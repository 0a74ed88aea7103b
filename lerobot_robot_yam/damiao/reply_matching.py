"""Matching of replies to requests.

A reply does not state its command. Three rules find the command for any adapter delay in either direction:

1. A motor replies in the order of its requests, so a reply belongs to the motor's oldest open request.
2. The wire keeps the order of ticks. Once a motor has replied to tick k, replies still owed for earlier ticks are lost.
3. A channel that has lost whole ticks looks like a channel that has become slower. So, when every motor has owed more
   replies than before for a while, or for a few ticks after a silence of the whole channel, the first motor gets no
   requests for some ticks. If its replies end before all owed ones have come, the rest are lost, and by rule 2 the
   other motors' owed replies are lost, too. A single motor that owes more replies than the others is left out of one
   tick; rule 2 then clears its owed replies.

While it is unknown whether replies are lost or delayed, a reply counts for the older request. Its sample may then seem
too old, but never too new.
"""

import math
from collections import deque
from collections.abc import Iterable, Sequence

_OPEN_MAX = 128  # maximum number of open requests per motor: 0.5 s at 250 Hz; a longer silence is a fault
_BEHIND_TICKS = 2  # consecutive ticks in which a motor owes more replies than the others before it is left out
_APART_TICKS, _APART_MAX_TICKS = 8, 128  # minimum and maximum interval at which the same motor is left out, ticks
_SLOW_TICKS = 50  # consecutive ticks in which all motors owe more than before until the first motor rests
_SILENT_TICKS = 3  # ticks without any reply after which a channel that replies again is examined at once
_AGAIN_TICKS = 3  # ticks until then: replies that were held back arrive together, in one tick or two
_ENDED_TICKS = 4  # consecutive ticks in which only other motors reply: then the resting motor's replies have ended
_REST_TICKS = 30  # maximum rest, ticks (0.12 s): without commands a motor goes limp after 0.4 s


class Request:
    """Request to several motors.

    Attributes:
        number: sequence number of the request.
        asked: number of motors that got the request.
        motors: indices of motors that have not replied yet.
        handle: whether the handle got the request and has not replied yet.
        sent_s: when the request was sent (the chain's clock).
        paced: whether there were pauses between the motors, so that `sent_s` is valid for the first motor only.

    Args:
        patient: whether to wait for the handle's reply.
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
        """Number of replies to wait for."""
        return len(self.motors) + (self.handle and self._patient)


class Requests:
    """Open requests to `count` motors.

    Attributes:
        newest: the last request.
        heard: indices of motors that have replied since the caller last cleared the set.
        duplicates: per motor, number of replies without a request.
        lost: per motor, number of replies that never arrived.
    """

    def __init__(self, count: int):
        self.newest = Request(0, (), False, False)
        self.heard: set[int] = set()
        self.duplicates = [0] * count
        self.lost = [0] * count
        self._open: list[deque[Request]] = [deque() for _ in range(count)]
        self._answered = 0  # number of the newest request to which any motor has replied
        self._handle_silent = False
        self._behind = [0] * count  # per motor: consecutive ticks in which it owes more replies than others
        self._left_out = [0] * count  # per motor: number of the last request that left it out
        self._apart = [_APART_TICKS] * count
        self._usual = 0  # replies that every motor owes at the next request: more with a slow adapter
        self._slow_ticks = self._silent_ticks = 0
        self._heard_of = 0  # newest answered request at the previous tick
        self._losses = 0  # losses of all motors, as of the previous tick
        # While the first motor rests (rule 3): number of replies, owed or lost, that had not come a tick ago; newest
        # answered request at that time; ticks since its replies ended; ticks for which it has been resting.
        self._rest: tuple[int, int, int, int] | None = None
        self._losses_of_first = 0  # losses of the first motor before its rest

    def absent(self) -> Sequence[int]:
        """Return the motors to leave out of the next tick, to find out whose replies are lost (rule 3)."""
        owed = [len(waiting) for waiting in self._open]
        if self._rest is not None:
            return [0] if self._go_on_resting(owed[0]) else ()
        if max(owed) == 0 == self._usual:  # the usual case
            self._slow_ticks = self._silent_ticks = 0
            return ()
        number = self.newest.number + 1
        losses, self._losses = self._losses, sum(self.lost)
        if losses != self._losses:  # the losses explain the owed replies, so no rest is needed
            self._slow_ticks = 0
        least = min(owed[1:] or owed)  # without the first motor, which owes fewer replies after a rest
        if len(owed) > 1:
            self._usual = min(self._usual, least)
        self._slow_ticks = self._slow_ticks + 1 if least > self._usual else 0
        self._look_for_silence()
        absent = [i for i, count in enumerate(owed) if self._is_behind(i, count > least, number)]
        if self._slow_ticks < _SLOW_TICKS or absent:
            return absent
        self._slow_ticks, self._usual = 0, least
        self._rest, self._losses_of_first = (owed[0] + self.lost[0], self._answered, 0, 0), self.lost[0]
        return [0]

    def _look_for_silence(self) -> None:
        """Let the first motor rest soon if the whole channel replies again after a silence."""
        if self._answered == self._heard_of:
            self._silent_ticks += 1
            return
        if self._silent_ticks >= _SILENT_TICKS and self._slow_ticks:
            self._slow_ticks = max(self._slow_ticks, _SLOW_TICKS - _AGAIN_TICKS)
        self._heard_of, self._silent_ticks = self._answered, 0

    def _go_on_resting(self, owed: int) -> bool:
        """Process a tick in which the first motor rested; return whether to leave this motor out of the next tick."""
        assert self._rest is not None
        before, answered, ended, ticks = self._rest
        missing = owed + self.lost[0]  # replies to other motors' requests may show that some are lost (rule 2)
        if missing != before:
            ended = 0
        elif self._answered != answered or len(self._open) == 1:
            ended += 1
        self._rest = missing, self._answered, ended, ticks + 1
        if ended == _ENDED_TICKS:
            self._give_up(0)
        if self._open[0] and ticks < _REST_TICKS:
            return True
        if self._open[0] or self.lost[0] > self._losses_of_first:  # else no reply was lost: the channel is slow
            self._usual = 0
        self._rest = None
        return False

    def _is_behind(self, motor: int, owes_more: bool, number: int) -> bool:
        """Return whether to leave out a motor that owes more than the others; after each time, the interval doubles."""
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
        """Register a request to which every motor replies `repeats` times."""
        asked = list(motors)
        # A silent handle must not delay every tick: its reply is awaited only if it replied to the previous request.
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
        """Record a motor's reply; return its request, None if the motor got none. Hot: once per frame."""
        waiting = self._open[index]
        if not waiting:
            self.duplicates[index] += 1
            return None
        self.heard.add(index)
        request = waiting.popleft()
        if request.number > self._answered:  # the first reply to a request closes earlier requests (rule 2)
            self._answered = request.number
            for i, others in enumerate(self._open):
                while others and others[0].number < request.number:
                    others.popleft()
                    self.lost[i] += 1
        request.motors.discard(index)
        return request

    def withdraw(self) -> None:
        """Record that the newest request was not sent, or not to all motors."""
        for i, waiting in enumerate(self._open):
            if waiting and waiting[-1] is self.newest:
                waiting.pop()
                self.lost[i] += 1

    @property
    def owed(self) -> bool:
        """Whether any reply is still expected."""
        return any(self._open)

    def forget(self) -> None:
        """Count replies that have not arrived by now as lost."""
        for i in range(len(self._open)):
            self._give_up(i)

    def _give_up(self, motor: int) -> None:
        self.lost[motor] += len(self._open[motor])
        self._open[motor].clear()

    def handle_answer(self) -> None:
        """Record that the handle has replied."""
        self._handle_silent = False
        self.newest.handle = False

    def give_up_handle(self) -> bool:
        """Record a missing reply of the handle; return whether the handle had got a request."""
        silent = self.newest.handle
        self._handle_silent |= silent
        return silent
