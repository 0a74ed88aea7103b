"""Which stretches of time count: windows in which the hypervisor took less than 1 % of the machine away.

A virtual machine loses time to its neighbours, and no scheduler can give it back. `/proc/stat` says how much was
stolen, in hundredths of a second; a window with more than `STEAL_MAX` of it says nothing about the code measured.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

WINDOW_S = 1.0
STEAL_MAX = 0.01
_STEAL_FIELD = 8  # of the line "cpu user nice system idle iowait irq softirq steal …"


def stolen() -> tuple[int, int]:
    """(stolen, total) time of all cores since boot, in clock ticks (1/100 s each)."""
    with open("/proc/stat") as file:
        fields = [int(text) for text in file.readline().split()[1:9]]
    return fields[_STEAL_FIELD - 1], sum(fields)


def cpu_s(pid: int) -> float:
    """CPU time of all threads of a process, in seconds, to the nanosecond (`/proc/PID/task/*/schedstat`)."""
    total = 0
    for path in Path(f"/proc/{pid}/task").glob("*/schedstat"):
        total += int(path.read_text().split()[0])
    return total * 1e-9


@dataclass
class Windows:
    """Windows in the order of time, on the clock of `time.monotonic()`.

    Attributes:
        edges_s: n + 1 window edges.
        good: per window, whether it counts.
    """

    edges_s: list[float] = field(default_factory=list)
    good: list[bool] = field(default_factory=list)
    _last: tuple[int, int] = (0, 0)

    def mark(self) -> None:
        """Set an edge here and judge the window that ends at it."""
        now, sample = time.monotonic(), stolen()
        if self.edges_s:
            total = max(sample[1] - self._last[1], 1)
            self.good.append((sample[0] - self._last[0]) / total < STEAL_MAX)
        self.edges_s.append(now)
        self._last = sample

    @property
    def used_s(self) -> float:
        """How much time counts."""
        lengths = np.diff(self.edges_s)
        return float(lengths[np.array(self.good, dtype=bool)].sum()) if self.good else 0.0

    @property
    def total_s(self) -> float:
        """How much time went by."""
        return self.edges_s[-1] - self.edges_s[0] if self.edges_s else 0.0

    def contains(self, times_s: np.ndarray) -> np.ndarray:
        """(n,) whether each time lies in a window that counts."""
        index = np.searchsorted(self.edges_s, times_s, side="right") - 1
        inside = (index >= 0) & (index < len(self.good))
        good = np.append(np.array(self.good, dtype=bool), [False])
        return inside & good[np.where(inside, index, -1)]


@dataclass
class Periods:
    """Periods between ticks, of the windows that counted.

    Attributes:
        ms: (n,) the periods, ms.
        used_s, total_s: time that counted, and time that went by.
    """

    ms: np.ndarray
    used_s: float
    total_s: float

    @property
    def hz(self) -> float:
        """Ticks per second of counted time."""
        return 1e3 / float(self.ms.mean()) if len(self.ms) else float("nan")

    def figures(self) -> dict[str, float]:
        """p50, p99, p999, max in ms, and how many periods they stand on."""
        return {**percentiles(self.ms, (50, 99, 99.9)), "count": len(self.ms)}


def periods(ticks_s: Sequence[float], windows: Windows) -> np.ndarray:
    """(m,) ms between neighbouring ticks, where both lie in windows that count."""
    ticks = np.asarray(ticks_s, dtype=float)
    if len(ticks) < 2:
        return np.zeros(0)
    good = windows.contains(ticks)
    return np.diff(ticks)[good[1:] & good[:-1]] * 1e3


def percentiles(values: np.ndarray, shares: Sequence[float]) -> dict[str, float]:
    """{"p50": …, …, "max": …} of the values; NaN without any."""
    names = [f"p{share:g}".replace(".", "") for share in shares]
    if len(values) == 0:
        return dict.fromkeys([*names, "max"], float("nan"))
    found = {name: float(np.percentile(values, share)) for name, share in zip(names, shares, strict=True)}
    return {**found, "max": float(values.max())}
