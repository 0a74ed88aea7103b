"""Whether a processor stood still: whoever rents it out now and then takes one away, and all that runs on it waits."""

import contextlib
import os
import threading
import time
from collections.abc import Callable

_PERIOD_S = 0.01
_PRIORITY = 90  # above everything of ours
_STALL_S = 0.05


class ProcessorWatch:
    """A thread for each processor that sleeps there, and tells when it wakes late.

    Args:
        tell: called with (since, until), monotonic s, from those threads.
    """

    def __init__(self, tell: Callable[[float, float], None]):
        self._tell = tell
        self._ended = threading.Event()
        self._threads = [
            threading.Thread(target=self._run, args=(cpu,), name=f"stalls-{cpu}", daemon=True)
            for cpu in os.sched_getaffinity(0)
        ]
        for thread in self._threads:
            thread.start()

    def _run(self, cpu: int) -> None:
        os.sched_setaffinity(0, {cpu})  # 0: this thread
        with contextlib.suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
        while not self._ended.is_set():
            before = time.monotonic()
            time.sleep(_PERIOD_S)
            now = time.monotonic()
            if now - before > _STALL_S:
                self._tell(before, now)

    def close(self) -> None:
        """End the threads."""
        self._ended.set()
        for thread in self._threads:
            thread.join()
