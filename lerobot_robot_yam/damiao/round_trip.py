"""Delay of a CAN adapter in each direction, used to estimate when a motor sampled its state.

A motor samples when a command reaches it. Of a round trip only the sum of the delays can be measured:

    arrival − sent = outbound + wire + return

The fastest of the recent replies are assumed to have had equal outbound and return delays. The extra time of a slower
reply is attributed to the return direction: adapters hold back received frames (USB polling, the 16 ms of a serial
adapter), but not sent ones.
"""

import math

from lerobot_robot_yam.damiao.tables import FRAME_TIME_S

_WINDOW_S = 0.15  # window, s, longer than adapters hold frames back; the fastest reply of the last two windows counts
SLOW_S = 0.002  # one-way delay above which an adapter counts as slow, s: half a tick at 250 Hz
HELD_S = 0.02  # round trip above which the adapter counts as holding frames back, s: five ticks


class RoundTrip:
    """Round-trip measurement of one channel.

    Attributes:
        one_way_s: the adapter's delay in each direction, from the fastest recent replies.
        slowest_s: maximum of `one_way_s` so far.
        longest_s: longest round trip of a reply so far, including its time on the wire.
    """

    def __init__(self) -> None:
        self.one_way_s = 0.0
        self.slowest_s = self.longest_s = 0.0
        self._until_s = -math.inf
        self._before = self._now = math.inf  # fastest round trips without wire time: last window, this window

    @property
    def slow(self) -> bool:
        """Whether the adapter was ever slow or ever held frames back."""
        return self.slowest_s > SLOW_S or self.longest_s > HELD_S

    def summary(self) -> str:
        """Describe how slow the adapter was, for messages."""
        answer = f"an answer took up to {self.longest_s * 1e3:.0f} ms"
        if self.slowest_s > SLOW_S:
            return f"the CAN adapter took up to {self.slowest_s * 1e3:.0f} ms each way: use a quicker one; {answer}"
        return f"{answer}: the CAN adapter held it back, or this machine was too busy"

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
            beside_wire_s = took_s - (count + place + 1) * FRAME_TIME_S
            if arrived_s > self._until_s or beside_wire_s < self._now:
                self._note(arrived_s, beside_wire_s)
        latest_s = max(sent_s, arrived_s - self.one_way_s - FRAME_TIME_S)
        return min(sent_s + self.one_way_s + (place + 1) * FRAME_TIME_S, latest_s), latest_s

    def _note(self, arrived_s: float, beside_wire_s: float) -> None:
        """Record the round trip, without wire time, that begins a window or is the fastest of its window so far."""
        if arrived_s > self._until_s:
            self.slowest_s = max(self.slowest_s, self.one_way_s)  # counted only when a whole window has had this delay
            quiet = arrived_s > self._until_s + _WINDOW_S
            self._before, self._now = math.inf if quiet else self._now, math.inf
            self._until_s = arrived_s + _WINDOW_S
        if beside_wire_s < self._now:
            self._now = beside_wire_s
        self.one_way_s = max(0.0, 0.5 * min(self._before, self._now))
