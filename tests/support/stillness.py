"""Whether a processor stood still: on each, a thread of the highest priority sleeps, and notes when it wakes late.

    python -m tests.support.stillness FILE

Whoever rents out two processors now and then takes them away. Then motors time out and cameras go stale as on a machine
that is too slow, and a test that fails has shown nothing: it is run again. On a still machine a failure is a failure.
"""

import ctypes
import math
import mmap
import os
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

from tests.support.paths import ROOT

PERIOD_S = 0.005
LATE_S = 0.004  # a tick of the control loop
PRIORITY = 90  # above everything of ours
_STAMP = struct.Struct("dd")  # of each processor: time of the last late wake; late in all, s
_CPUS = sorted(os.sched_getaffinity(0))
_PR_SET_TIMERSLACK = 29


class Stillness:
    """Reads what the process writes; `late_s` is -inf and `lost_s` 0 where it was refused its priority."""

    def __init__(self, path: Path):
        self._path = path
        self._map: mmap.mmap | None = None

    def start(self) -> subprocess.Popen:
        """Start the process."""
        self._path.write_bytes(_STAMP.pack(-math.inf, 0.0) * len(_CPUS))
        return subprocess.Popen([sys.executable, "-m", "tests.support.stillness", str(self._path)], cwd=ROOT)

    def late_s(self) -> float:
        """Monotonic time of the last late wake."""
        return self._read()[0]

    def lost_s(self) -> float:
        """How late it has woken so far, all late wakes on all processors together."""
        return self._read()[1]

    def _read(self) -> tuple[float, float]:
        if self._map is None:
            with open(self._path, "rb") as file:
                self._map = mmap.mmap(file.fileno(), 0, prot=mmap.PROT_READ)
        late, lost = zip(*_STAMP.iter_unpack(self._map), strict=True)
        return max(late), sum(lost)


def _watch(path: Path) -> None:
    try:
        with open(path, "r+b") as file:
            stamps = mmap.mmap(file.fileno(), 0)
    except FileNotFoundError:  # the tests have ended already
        return
    for slot, cpu in enumerate(_CPUS):
        threading.Thread(target=_watch_processor, args=(cpu, stamps, slot * _STAMP.size)).start()


def _watch_processor(cpu: int, stamps: mmap.mmap, at: int) -> None:
    os.sched_setaffinity(0, {cpu})  # of this thread
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except PermissionError:  # not for us to ask for
        return
    ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1000, 0, 0, 0)
    parent, lost = os.getppid(), 0.0
    while os.getppid() == parent:
        due = time.monotonic() + PERIOD_S
        time.sleep(PERIOD_S)
        now = time.monotonic()
        if now - due > LATE_S:
            lost += now - due
            _STAMP.pack_into(stamps, at, now, lost)


if __name__ == "__main__":
    _watch(Path(sys.argv[1]))
