"""Detection of processor stalls: a host may take a processor away, and everything running on that processor waits."""

import contextlib
import multiprocessing
import os
import time
from collections.abc import Iterator
from multiprocessing.connection import Connection

_PERIOD_S = 0.01
_PRIORITY = 90  # above all other threads of the soak
_STALL_S = 0.05


class ProcessorWatch:
    """One sleeping process per processor that reports late wake-ups; reports nothing without real-time permission."""

    def __init__(self) -> None:
        self._telling, told = multiprocessing.Pipe(duplex=False)
        self._processes = [
            multiprocessing.Process(target=_watch, args=(cpu, os.getpid(), told), daemon=True)
            for cpu in sorted(os.sched_getaffinity(0))
        ]
        for process in self._processes:
            process.start()

    def news(self) -> Iterator[tuple[float, float]]:
        """Yield (since, until) of stalls since the last call, monotonic s."""
        while self._telling.poll():
            yield self._telling.recv()

    def close(self) -> None:
        """Kill the processes."""
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
