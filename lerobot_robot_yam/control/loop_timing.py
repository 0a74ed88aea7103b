"""Timing statistics of a loop: a histogram of periods with constant cost per tick, and a summary at the end."""

import logging
import math

import numpy as np

logger = logging.getLogger(__name__)

MOST_DT_S = 0.012  # maximum time that a loop plans in one tick, s: set-points do not leap after a pause
_BIN_S = 1e-5
_WINDOW_S = 1.0
_SLOW_SHARE = 0.2
_TOLD_S = 60.0  # minimum time between two warnings of a slow loop, s: on a busy machine slow phases recur
_BINS = 10_000  # number of bins, up to 0.1 s; longer periods count in the last bin, the true maximum is kept


class LoopStatistics:
    """Cycle, overrun and period statistics of a loop with nominal period `period_s` (0: no nominal period)."""

    def __init__(self, period_s: float):
        self.period_s = period_s
        self.cycles = 0
        self.overruns = 0
        self._histogram = np.zeros(_BINS, dtype=np.int64)
        self._longest_s = 0.0
        self._last: float | None = None
        self._window_from, self._cycles_then, self._overruns_then = 0.0, 0, 0
        self._slow_windows, self._told = 0, -math.inf

    def tick(self, now: float) -> None:
        """Count one cycle that began at `now`."""
        if self._last is not None:
            period = now - self._last
            self._histogram[min(int(period / _BIN_S), _BINS - 1)] += 1
            self._longest_s = max(self._longest_s, period)
        self._last = now
        self.cycles += 1
        if now - self._window_from > _WINDOW_S:
            self._look_back(now)

    def _look_back(self, now: float) -> None:
        """Log a warning if too many ticks of the last window were late."""
        late, ticks = self.overruns - self._overruns_then, self.cycles - self._cycles_then
        if self._window_from and late > _SLOW_SHARE * ticks:
            self._slow_windows += 1
            if now - self._told > _TOLD_S:
                self._told = now
                why = "is this machine too busy?"
                logger.warning("control loop is slow: %d of the last %d ticks were late; %s", late, ticks, why)
        self._window_from, self._cycles_then, self._overruns_then = now, self.cycles, self.overruns

    def percentile_ms(self, share: float) -> float:
        """Return the period, ms, below which `share` (0 … 1) of all periods lie; NaN before the second cycle."""
        total = int(self._histogram.sum())
        if total == 0:
            return float("nan")
        index = int(np.searchsorted(np.cumsum(self._histogram), share * total))
        return min((index + 1) * _BIN_S, self._longest_s) * 1e3

    def summary(self) -> str:
        """Return the statistics as one line for the log."""
        slow = f", slow for {self._slow_windows * _WINDOW_S:.0f} s" if self._slow_windows else ""
        return (
            f"{self.cycles} cycles, {self.overruns} overruns{slow}, period p50 {self.percentile_ms(0.5):.2f} ms, "
            f"p99 {self.percentile_ms(0.99):.2f}, p99.9 {self.percentile_ms(0.999):.2f}, "
            f"max {self._longest_s * 1e3:.2f}"
        )
