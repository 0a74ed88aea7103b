"""Real-time scheduling and locked memory, where the kernel permits them."""

import contextlib
import ctypes
import gc
import os
import platform
import struct
from pathlib import Path

_LIBC = ctypes.CDLL(None, use_errno=True)
_SCHED_SETATTR = {"x86_64": 314, "aarch64": 274}.get(platform.machine())
_SCHED_ATTR = struct.Struct("<IIQiIQQQII")  # size, policy, flags, nice, priority, runtime, deadline, period, 2 clamps
_SHORT_SLICE_NS = 100_000  # minimum slice that Linux >= 6.12 grants without privilege, ns
_PR_SET_TIMERSLACK = 29
_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_BUFFER_BYTES = 16 << 20  # minimum size of memory that is only reserved, bytes: numpy's OpenBLAS reserves 32 MB
_GIVING_WAY_NICE = 2  # nice value: two thirds of the usual CPU share, so that a busy machine still draws images
_OOM_SCORES = (-900, 0)  # OOM scores to try, of -1000 … 1000; only root may go below a process's initial score


def request_realtime(priority: int) -> str:
    """Request SCHED_FIFO at `priority` (else slices of 0.1 ms), locked memory and a timer slack of 1 µs.

    Also exempts all existing objects from garbage collection. Call this once, after start-up, in the thread that runs
    the loop. Child processes do not inherit the scheduling.

    Returns:
        What was granted, for the log, such as "SCHED_FIFO 10, memory locked".
    """
    gc.collect()
    gc.freeze()
    _LIBC.prctl(_PR_SET_TIMERSLACK, 1000, 0, 0, 0)
    scheduling = request_scheduling(priority)
    return f"{scheduling}, memory {'locked' if _lock_memory() else 'not locked'}"


def _lock_memory() -> bool:
    """Load all memory and keep it loaded, except for large buffers, whose pages stay once they are used.

    Returns:
        Whether the kernel has granted it.
    """
    if _LIBC.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) != 0:
        return False
    for line in Path("/proc/self/maps").read_text().splitlines():
        place, _, _, _, inode, *_ = line.split()
        start, end = (int(address, 16) for address in place.split("-"))
        if inode != "0" or end - start < _BUFFER_BYTES:
            _LIBC.mlock(ctypes.c_void_p(start), ctypes.c_size_t(end - start))  # loads it; fails for guard pages
    return True


def raise_threads(priority: int, named: str) -> None:
    """Request SCHED_FIFO at `priority` for threads whose names begin with `named`; ignore a refusal.

    Call this only after the threads have got their names: libzmq sets the scheduling before the name, and aborts the
    process if the scheduling was changed earlier.
    """
    for thread in Path("/proc/self/task").iterdir():
        with contextlib.suppress(OSError):  # no privilege and no RLIMIT_RTPRIO, or the thread has ended
            if (thread / "comm").read_text().startswith(named):
                policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
                os.sched_setscheduler(int(thread.name), policy, os.sched_param(priority))


def spare_what_is_loaded() -> None:
    """Exempt all existing objects from Python's garbage collection.

    A LeRobot command has half a million objects after its start. Once there are a quarter more, Python would scan all
    of them, even in the middle of an episode, and the arms would get no target for 0.25 s.
    """
    gc.freeze()


def give_way() -> None:
    """Lower the priority of this process. Requires a session of its own (`start_new_session`).

    Linux first distributes the processors among sessions (autogroup); a nice value applies only within a session.
    """
    os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))  # a batch process preempts no other when it wakes up
    os.setpriority(os.PRIO_PROCESS, 0, _GIVING_WAY_NICE)
    with contextlib.suppress(OSError):  # no autogroups in the kernel, or another nice value was set within 0.1 s
        Path("/proc/self/autogroup").write_text(str(_GIVING_WAY_NICE))


def avoid_oom_killer() -> str:
    """Lower this process's OOM score, so that the kernel kills others first. Child processes inherit the score.

    Returns:
        The new score, for the log, such as "out-of-memory score -900".
    """
    path = Path("/proc/self/oom_score_adj")
    score = int(path.read_text())
    for wish in _OOM_SCORES:
        if wish < score:
            try:
                path.write_text(str(wish))
                score = wish
            except OSError:
                pass  # lowering the score requires privilege
    return f"out-of-memory score {score}"


def request_scheduling(priority: int) -> str:
    """Request the scheduling of `request_realtime` for the calling thread; return what was granted."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
        return f"SCHED_FIFO {priority}"
    except OSError:
        pass  # SCHED_FIFO requires privilege or RLIMIT_RTPRIO
    if _SCHED_SETATTR is not None:
        attributes = _SCHED_ATTR.pack(_SCHED_ATTR.size, os.SCHED_OTHER, 0, 0, 0, _SHORT_SLICE_NS, 0, 0, 0, 0)
        kernel = tuple(int(part) for part in platform.release().split(".")[:2] if part.isdigit())
        if kernel >= (6, 12) and _LIBC.syscall(_SCHED_SETATTR, 0, attributes, 0) == 0:
            return "normal scheduling with 0.1 ms slices"
    return "normal scheduling (real time was refused)"
