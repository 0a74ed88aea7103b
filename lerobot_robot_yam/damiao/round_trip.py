"""Delays of an adapter each way, and thus when a motor took the sample that it sent.

A motor samples when a command reaches it. Of a round trip only the sum is known:

    arrival − sent = out + wire + back

The quickest of the last answers are assumed to have had equal delays on their way out and back. A slower answer
lost its time on the way back: adapters hold back frames that they have received (USB polling, the 16 ms of a serial
adapter), not frames that they send.
"""

import math

from lerobot_robot_yam.damiao.tables import FRAME_TIME_S

_WINDOW_S = 0.15  # window, longer than adapters hold frames back; the quickest answer of the last two counts
SLOW_S = 0.002  # time each way above which an adapter is slow: half a tick at 250 Hz
HELD_S = 0.02  # round trip above which an adapter holds frames back: five ticks


class RoundTrip:
    """Measurement of the round trips of one channel.

    Attributes:
        one_way_s: the adapter's delay each way, by the quickest recent answers.
        slowest_s: the largest `one_way_s` so far.
        longest_s: the longest round trip of an answer so far, wire included.
    """

    def __init__(self) -> None:
        self.one_way_s = 0.0
        self.slowest_s = self.longest_s = 0.0
        self._until_s = -math.inf
        self._before = self._now = math.inf  # quickest round trips, without the wire, of the last window and of this

    @property
    def slow(self) -> bool:
        """Whether the adapter has been slow, or has held frames back."""
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
        """Return when a motor took the sample in its answer: most likely, and at the latest.

        Args:
            sent_s, arrived_s: times of the command and of its answer (the same clock).
            place: place of the motor among those asked, from 0.
            count: number of motors that were asked.
            paced: whether there were pauses between the motors, so that the time says nothing about the adapter.
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
        """Note a round trip, without its time on the wire, that is the quickest of its window so far, or the first."""
        if arrived_s > self._until_s:
            self.slowest_s = max(self.slowest_s, self.one_way_s)  # delay of a whole window
            quiet = arrived_s > self._until_s + _WINDOW_S
            self._before, self._now = math.inf if quiet else self._now, math.inf
            self._until_s = arrived_s + _WINDOW_S
        if beside_wire_s < self._now:
            self._now = beside_wire_s
        self.one_way_s = max(0.0, 0.5 * min(self._before, self._now))
