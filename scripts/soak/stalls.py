"""Whether a processor stood still: whoever rents it out now and then takes one away, and all that runs on it waits."""

import contextlib
import multiprocessing
import os
import time
from collections.abc import Iterator
from multiprocessing.connection import Connection

_PERIOD_S = 0.01
_PRIORITY = 90  # above everything of ours
_STALL_S = 0.05


class ProcessorWatch:
    """A process for each processor sleeps there, and tells when it wakes late; where it may not come first, nothing."""

    def __init__(self) -> None:
        self._telling, told = multiprocessing.Pipe(duplex=False)
        self._processes = [
            multiprocessing.Process(target=_watch, args=(cpu, os.getpid(), told), daemon=True)
            for cpu in sorted(os.sched_getaffinity(0))
        ]
        for process in self._processes:
            process.start()

    def news(self) -> Iterator[tuple[float, float]]:
        """(since, until) of what stood still since the last call, monotonic s."""
        while self._telling.poll():
            yield self._telling.recv()

    def close(self) -> None:
        """End the processes."""
        for process in self._processes:
            process.kill()
            process.join()


def _watch(cpu: int, parent: int, told: Connection) -> None:
    os.sched_setaffinity(0, {cpu})
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
        while os.getppid() == parent:
            before = time.monotonic()
            time.sleep(_PERIOD_S)
            now = time.monotonic()
            if now - before > _STALL_S:
                told.send((before, now))
