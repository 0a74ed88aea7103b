"""Real-time scheduling and locked memory, as far as the kernel grants them."""

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
_SHORT_SLICE_NS = 100_000  # the shortest slice that Linux >= 6.12 grants without privilege
_PR_SET_TIMERSLACK = 29
_MCL_CURRENT, _MCL_FUTURE = 1, 2
_GIVING_WAY_NICE = 2  # nice value for two thirds of an ordinary share: on a full machine pictures come late, not never
_OOM_SCORES = (-900, 0)  # wishes, of -1000 … 1000; only root may go below the score that a process started with


def request_realtime(priority: int) -> str:
    """Request SCHED_FIFO at `priority`, else a 0.1 ms slice; locked memory; 1 µs timer slack.

    It also exempts all present objects from garbage collection. Call it once, after start-up, in the thread that runs
    the loop. Children do not inherit the scheduling.

    Returns:
        What was granted, for the log: for example "SCHED_FIFO 10, memory locked".
    """
    gc.collect()
    gc.freeze()
    _LIBC.prctl(_PR_SET_TIMERSLACK, 1000, 0, 0, 0)
    scheduling = request_scheduling(priority)
    locked = _LIBC.mlockall(_MCL_CURRENT | _MCL_FUTURE) == 0
    return f"{scheduling}, memory {'locked' if locked else 'not locked'}"


def raise_threads(priority: int, named: str) -> None:
    """Request SCHED_FIFO at `priority` for the threads whose names begin with `named`; a refusal changes nothing.

    libzmq names its threads after it has set their scheduling. To change the scheduling earlier ends the process.
    """
    for thread in Path("/proc/self/task").iterdir():
        with contextlib.suppress(OSError):  # needs privilege or RLIMIT_RTPRIO; or it has ended
            if (thread / "comm").read_text().startswith(named):
                policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
                os.sched_setscheduler(int(thread.name), policy, os.sched_param(priority))


def spare_what_is_loaded() -> None:
    """Exempt all present objects from Python's garbage collector.

    A LeRobot command has half a million objects after its start. Python would walk them when there are a quarter more,
    in the middle of an episode, and send the arms no target for 0.25 s.
    """
    gc.freeze()


def give_way() -> None:
    """Let this process run in the time that others leave. It needs a session of its own (`start_new_session`).

    Linux shares the processors among sessions first (autogroup); a nice value counts only within a session.
    """
    os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))  # it preempts nobody by waking up
    os.setpriority(os.PRIO_PROCESS, 0, _GIVING_WAY_NICE)
    with contextlib.suppress(OSError):  # a kernel without them, or somebody else's was set within 0.1 s
        Path("/proc/self/autogroup").write_text(str(_GIVING_WAY_NICE))


def avoid_oom_killer() -> str:
    """Request to be killed among the last when memory runs out. Children inherit it.

    Returns:
        The score now, for the log: for example "out-of-memory score -900".
    """
    path = Path("/proc/self/oom_score_adj")
    score = int(path.read_text())
    for wish in _OOM_SCORES:
        if wish < score:
            try:
                path.write_text(str(wish))
                score = wish
            except OSError:
                pass  # needs privilege
    return f"out-of-memory score {score}"


def request_scheduling(priority: int) -> str:
    """Request the scheduling of `request_realtime` for the calling thread; returns what was granted."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
        return f"SCHED_FIFO {priority}"
    except OSError:
        pass  # needs privilege or RLIMIT_RTPRIO
    if _SCHED_SETATTR is not None:
        attributes = _SCHED_ATTR.pack(_SCHED_ATTR.size, os.SCHED_OTHER, 0, 0, 0, _SHORT_SLICE_NS, 0, 0, 0, 0)
        kernel = tuple(int(part) for part in platform.release().split(".")[:2] if part.isdigit())
        if kernel >= (6, 12) and _LIBC.syscall(_SCHED_SETATTR, 0, attributes, 0) == 0:
            return "normal scheduling with 0.1 ms slices"
    return "normal scheduling (real time was refused)"
