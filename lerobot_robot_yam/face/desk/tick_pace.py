"""How fast a command's loop really runs. The loop itself only notes the time; somebody else counts."""

import time
from collections import deque

_LATE = 1.5  # of a tick's time, as `EpisodeFigures` counts
_RECENT_S = 5.0
_KEPT = 4096  # times that nobody has counted yet


class TickPace:
    """Of one loop after the other. `tick` is for the loop's thread, `count` for another one."""

    def __init__(self) -> None:
        self._new = deque[float](maxlen=_KEPT)
        self._recent = deque[float]()
        self._run: float | None = None
        self._late = 0

    def tick(self) -> None:
        """The loop has observed, just now."""
        self._new.append(time.perf_counter())

    def count(self, run: float, began_s: float, fps: float) -> tuple[float | None, int]:
        """Ticks per second, of the last 5 s, and how many ticks of this run of the loop came late.

        Args:
            run: tells it from the one before.
            began_s: when it began, on `time.perf_counter`.
            fps: ticks per second that are asked for.

        Returns:
            None in the place of the rate, before there are two ticks.
        """
        if run != self._run:
            self._run, self._late = run, 0
            self._recent.clear()
        while self._new:
            at_s = self._new.popleft()
            if at_s >= began_s:
                self._late += bool(self._recent) and at_s - self._recent[-1] > _LATE / fps
                self._recent.append(at_s)
        while len(self._recent) > 1 and self._recent[-1] - self._recent[0] > _RECENT_S:
            self._recent.popleft()
        if len(self._recent) < 2:
            return None, self._late
        return (len(self._recent) - 1) / (self._recent[-1] - self._recent[0]), self._late
