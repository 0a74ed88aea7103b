"""How far the host's monotonic clock is ahead of ours, by the quickest of the last round trips.

An echo that was sent at t0, arrived at the host at t1, left it at t2 and came back at t3 says

    offset = ((t1 - t0) + (t2 - t3)) / 2        wrong by at most half of (t3 - t0) - (t2 - t1)

(RFC 5905, section 8). Of a window of echoes the one with the shortest round trip counts. It counts no longer once an
echo contradicts it: the monotonic clock of a computer that sleeps stands still.
"""

import math
from collections import deque
from typing import NamedTuple

from lerobot_robot_yam.remote.wire.link_messages import Echo

_WINDOW = 50  # echoes, 5 s: two clocks drift apart by 0.1 ms in that time
_DRIFT_S = 0.001  # that much is no contradiction


class _Measured(NamedTuple):
    round_trip_s: float
    offset_s: float


class ClockOffset:
    """Of one host. Add its offset to a time of ours and it is the host's.

    Attributes:
        offset_s: host's clock minus ours; NaN before the first echo.
        error_s: by which it may be wrong.
    """

    def __init__(self) -> None:
        self._measured: deque[_Measured] = deque(maxlen=_WINDOW)
        self.offset_s, self.error_s = math.nan, math.inf

    def __len__(self) -> int:
        return len(self._measured)

    def add(self, echo: Echo, now: float) -> None:
        """Take an echo that came back `now`, s; one that says it took less than no time does not count."""
        round_trip_s = (now - echo.sent_s) - (echo.answered_s - echo.received_s)
        if round_trip_s < 0.0 or echo.answered_s < echo.received_s:
            return
        offset_s = ((echo.received_s - echo.sent_s) + (echo.answered_s - now)) / 2.0
        if abs(offset_s - self.offset_s) > self.error_s + round_trip_s / 2.0 + _DRIFT_S:  # False for NaN
            self.clear()
        self._measured.append(_Measured(round_trip_s, offset_s))
        best = min(self._measured)
        self.offset_s, self.error_s = best.offset_s, best.round_trip_s / 2.0

    def clear(self) -> None:
        """Forget: the host is another one, or has booted, or one of both has slept."""
        self._measured.clear()
        self.offset_s, self.error_s = math.nan, math.inf
