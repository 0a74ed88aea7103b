"""Delay of a CAN adapter in each direction, used to estimate when a motor sampled its state.

A motor samples when a command reaches it. Of a round trip only the sum of the delays can be measured:

    arrival − sent = outbound + wire + return

The fastest of the recent replies are assumed to have had equal outbound and return delays. The extra time of a slower
reply is attributed to the return direction: adapters hold back received frames (USB polling, the 16 ms of a serial
adapter), but not sent ones.
"""

import math

from lerobot_robot_yam.damiao.tables import FRAME_TIME_S

_SURE_S = 0.6  # time, s, after which a delay is sure: it takes up to 0.35 s to find out that replies were lost
_WINDOW_S = 0.15  # window, s, longer than adapters hold frames back; the fastest reply of the last two windows counts
SLOW_S = 0.002  # one-way delay above which an adapter counts as slow, s: half a tick at 250 Hz
HELD_S = 0.02  # round trip above which the adapter counts as holding frames back, s: five ticks


class RoundTrip:
    """Round-trip measurement of one channel.

    After a loss, replies count for older requests until it is known which were lost, and seem that much too slow. So a
    delay is held against the adapter only if no loss is found within `_SURE_S` afterwards.

    Attributes:
        one_way_s: the adapter's delay in each direction, from the fastest recent replies.
        longest_s: longest round trip of a reply so far, including its time on the wire.
    """

    def __init__(self) -> None:
        self.one_way_s = self.longest_s = 0.0
        # maxima of `one_way_s` and of round trips, s: those that are sure; of the last `_SURE_S`; since `_sure_until_s`
        self._sure = self._later = self._newest = (0.0, 0.0)
        self._sure_until_s = -math.inf
        self._until_s = -math.inf
        self._before = self._now = math.inf  # fastest round trips without wire time: last window, this window

    @property
    def slow(self) -> bool:
        """Whether the adapter was ever slow or ever held frames back."""
        slowest_s, longest_s = self._sure
        return slowest_s > SLOW_S or longest_s > HELD_S

    def summary(self) -> str:
        """Describe how slow the adapter was, for messages."""
        slowest_s, longest_s = self._sure
        answer = f"an answer took up to {longest_s * 1e3:.0f} ms"
        if slowest_s > SLOW_S:
            return f"the CAN adapter took up to {slowest_s * 1e3:.0f} ms each way: use a quicker one; {answer}"
        return f"{answer}: the CAN adapter held it back, or this machine was too busy"

    def doubt(self) -> None:
        """Forget the delays that are not sure yet: replies were lost, which may have made others seem slow."""
        self._later = self._newest = (0.0, 0.0)

    def sampled_s(
        self, sent_s: float, arrived_s: float, place: int, count: int, paced: bool = False
    ) -> tuple[float, float]:
        """Return two estimates of when a motor sampled the state in its reply: the most likely and the latest time.

        Args:
            sent_s, arrived_s: times of the command and of its reply (the same clock).
            place: the motor's index in the order of sending, from 0.
            count: number of motors to which commands were sent.
            paced: whether there were pauses between the commands; then the round trip does not measure the adapter.
        """
        if not paced:
            took_s = arrived_s - sent_s
            if took_s > self.longest_s:
                self.longest_s = took_s
            if took_s > self._newest[1]:
                self._newest = (self._newest[0], took_s)
            beside_wire_s = took_s - (count + place + 1) * FRAME_TIME_S
            if arrived_s > self._until_s or beside_wire_s < self._now:
                self._note(arrived_s, beside_wire_s)
        latest_s = max(sent_s, arrived_s - self.one_way_s - FRAME_TIME_S)
        return min(sent_s + self.one_way_s + (place + 1) * FRAME_TIME_S, latest_s), latest_s

    def _note(self, arrived_s: float, beside_wire_s: float) -> None:
        """Record the round trip, without wire time, that begins a window or is the fastest of its window so far."""
        if arrived_s > self._until_s:
            if arrived_s > self._sure_until_s:
                self._sure = max(self._sure[0], self._later[0]), max(self._sure[1], self._later[1])
                self._later, self._newest = self._newest, (0.0, 0.0)
                self._sure_until_s = arrived_s + _SURE_S
            # counted only when a whole window has had this delay
            self._newest = max(self._newest[0], self.one_way_s), self._newest[1]
            quiet = arrived_s > self._until_s + _WINDOW_S
            self._before, self._now = math.inf if quiet else self._now, math.inf
            self._until_s = arrived_s + _WINDOW_S
        if beside_wire_s < self._now:
            self._now = beside_wire_s
        self.one_way_s = max(0.0, 0.5 * min(self._before, self._now))
