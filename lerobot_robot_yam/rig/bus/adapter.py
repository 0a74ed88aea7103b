"""CAN adapter between the clients of a channel and its wire: delays frames and can hold back received frames.

The adapter preserves the order in both directions: each frame is delivered no earlier than the frame before.
"""

import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

from lerobot_robot_yam.rig.devices.packets import Frame

# Latency, s, from which commands are queued. Below this latency motors obey immediately, and their positions are
# extrapolated to the time of the reply. The extrapolation is accurate enough and saves the rig a wake-up.
_WAITS_FROM_S = 0.001


class Listener(Protocol):
    """Client of a channel: a socket, or an object with a socket's `send`."""

    def send(self, data: bytes, flags: int = 0, /) -> int: ...


@dataclass(frozen=True)
class HoldBack:
    """Interval of `seconds` starting at `begin_s`, repeated every `every_s`, in which received frames are held back."""

    begin_s: float
    seconds: float
    every_s: float = math.inf

    def release_s(self, at_s: float) -> float:
        """Return the time at which a frame that the wire delivers at `at_s` reaches the host, s."""
        since_s = at_s - self.begin_s
        if since_s < 0.0:
            return at_s
        phase_s = since_s if self.every_s == math.inf else since_s % self.every_s
        return at_s + max(0.0, self.seconds - phase_s)


class Adapter:
    """Delays of one channel: `latency_s` in each direction, and `hold`.

    due_s: time at which the next delayed command reaches the wire, s; infinity if no command is queued.
    """

    def __init__(self, latency_s: float):
        self.latency_s = latency_s
        self.hold: HoldBack | None = None
        self.due_s = math.inf
        self._given_s = -math.inf  # time of the last frame delivered to clients
        self._sent: deque[tuple[float, Listener, Frame]] = deque()  # commands, with their times on the wire

    @property
    def waits(self) -> bool:
        """Whether commands are queued before they reach the wire."""
        return self.latency_s >= _WAITS_FROM_S or bool(self._sent)

    def put(self, sender: Listener, timed: Sequence[tuple[float, Frame]]) -> None:
        """Queue a client's frames, each with the time at which it reaches the wire."""
        for due_s, frame in timed:
            self._sent.append((max(due_s, self._sent[-1][0]) if self._sent else due_s, sender, frame))
        self._look_ahead()

    def take(self, until_s: float) -> Iterator[tuple[Listener, list[tuple[float, Frame]]]]:
        """Yield the frames that reach the wire up to `until_s`, in order, grouped by client and time."""
        while self._sent and self._sent[0][0] <= until_s:
            due_s, sender, _ = self._sent[0]
            group = []
            while self._sent and self._sent[0][:2] == (due_s, sender):
                group.append((due_s, self._sent.popleft()[2]))
            self._look_ahead()
            yield sender, group

    def arrival_s(self, through_s: float) -> float:
        """Return the time at which the host receives a frame that the wire delivered at `through_s`, s."""
        at_s = max(through_s + self.latency_s, self._given_s)
        if self.hold is not None:
            at_s = self.hold.release_s(at_s)
        self._given_s = at_s
        return at_s

    def arrivals_s(self, through_s: list[float]) -> list[float]:
        """Return `arrival_s` for several frames, in order."""
        if self.hold is not None or through_s[0] + self.latency_s < self._given_s:
            return [self.arrival_s(at_s) for at_s in through_s]
        arrived_s = [at_s + self.latency_s for at_s in through_s]
        self._given_s = arrived_s[-1]
        return arrived_s

    def _look_ahead(self) -> None:
        self.due_s = self._sent[0][0] if self._sent else math.inf
