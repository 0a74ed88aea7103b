"""Timing of a loop: a histogram that costs the same on every tick, and what it says at the end."""

import numpy as np

_BIN_S = 1e-5
_BINS = 10_000  # up to 0.1 s; longer periods fall into the last bin, their true maximum is kept


class LoopStatistics:
    """Counts cycles, overruns and periods of a loop with a nominal period of `period_s` (0: no nominal period)."""

    def __init__(self, period_s: float):
        self.period_s = period_s
        self.cycles = 0
        self.overruns = 0
        self._histogram = np.zeros(_BINS, dtype=np.int64)
        self._longest_s = 0.0
        self._last: float | None = None

    def tick(self, now: float) -> None:
        """Count one cycle that began at `now`."""
        if self._last is not None:
            period = now - self._last
            self._histogram[min(int(period / _BIN_S), _BINS - 1)] += 1
            self._longest_s = max(self._longest_s, period)
        self._last = now
        self.cycles += 1

    def percentile_ms(self, share: float) -> float:
        """Period below which `share` (0 … 1) of all periods lie, ms; NaN before two cycles."""
        total = int(self._histogram.sum())
        if total == 0:
            return float("nan")
        index = int(np.searchsorted(np.cumsum(self._histogram), share * total))
        return min((index + 1) * _BIN_S, self._longest_s) * 1e3

    def summary(self) -> str:
        """One line for the log."""
        return (
            f"{self.cycles} cycles, {self.overruns} overruns, period p50 {self.percentile_ms(0.5):.2f} ms, "
            f"p99 {self.percentile_ms(0.99):.2f}, p99.9 {self.percentile_ms(0.999):.2f}, "
            f"max {self._longest_s * 1e3:.2f}"
        )
