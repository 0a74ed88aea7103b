"""Thread that injects faults on schedule, and ends them."""

import contextlib
import logging
import math
import os
import queue
import signal
import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from lerobot_robot_yam.rig.control import RigControl
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from soak.arm import newest_record
from soak.injected_faults import CHANNELS, RANDOM
from soak.schedule import Injection

logger = logging.getLogger("soak")

_POLL_S = 0.01
_SEEN_S = 0.05  # a loop sees the release of an emergency stop at the next tick, however late this tick is
_GAP_S = 0.2  # minimum interval between injections that were delayed
_LOSS_RATE = 0.01  # fraction of all frames to and from all motors that are always lost
_SIGNALS = {"kill_control": signal.SIGKILL, "stop_control": signal.SIGSTOP}
_FOR_CALLER = frozenset({"caller_stall", "far_action"})


class Injector(threading.Thread):
    """Executes a schedule in its own thread, with its own connection to the rig.

    Faults of the caller (it stalls, or requests distant poses) are put into `for_caller`; the caller carries them out
    and calls `began`.

    Args:
        rig: name of the rig.
        keys: keys of the state blocks, by channel.
        schedule: the injections, in order of time.
    """

    def __init__(self, rig: str, keys: Mapping[str, str], schedule: Sequence[Injection]):
        super().__init__(name="soak-injector", daemon=True)
        self._rig = RigControl(rig, hold=False)
        self._keys, self._schedule = keys, list(schedule)
        self._begin_s = math.inf
        self.for_caller: queue.SimpleQueue[Injection] = queue.SimpleQueue()
        self.injected: Counter[str] = Counter()
        self.log: list[tuple[float, Injection]] = []  # injections that really happened, with their monotonic times, s
        self.error: BaseException | None = None
        self._active: list[tuple[float, Injection]] = []
        self._lock = threading.RLock()  # protects the connection and the list of active injections
        self._paused = threading.Event()
        self._ended = threading.Event()
        self.lossy()

    def lossy(self) -> None:
        """From now on, lose a fraction `_LOSS_RATE` of all frames in both directions."""
        with self._lock:
            for channel in CHANNELS:
                self._rig.fault(channel, None, "loss_rate", _LOSS_RATE)
                self._rig.fault(channel, None, "command_loss_rate", _LOSS_RATE)

    def begin(self, now_s: float) -> None:
        """Start the schedule; `now_s` is its time 0."""
        self._begin_s = now_s
        self.start()

    @property
    def position(self) -> int:
        """Number of the latest injection, -1 before the first."""
        return self.log[-1][1].number if self.log else -1

    @property
    def left(self) -> int:
        """Number of injections that have not happened yet, including delayed ones."""
        return len(self._schedule) + self.for_caller.qsize()

    def run(self) -> None:
        """Inject and undo faults until `end`; runs in the thread."""
        try:
            last_s = 0.0
            while not self._ended.wait(_POLL_S):
                now = time.monotonic()
                self._undo_until(now)
                due = self._schedule and self._schedule[0].at_s <= now - self._begin_s
                if due and not self._paused.is_set() and now - last_s >= _GAP_S:
                    last_s = now
                    self._inject(self._schedule.pop(0))
        except BaseException as error:
            self.error = error
            raise
        finally:
            self._undo_until(float("inf"))

    def _undo_until(self, now: float) -> None:
        with self._lock:
            for row in [row for row in self._active if row[0] <= now]:
                self._active.remove(row)
                self._undo(row[1])

    @contextlib.contextmanager
    def quiet(self) -> Iterator[None]:
        """Inside the block, suspend injections and keep all faults undone."""
        self._paused.set()
        try:
            while self._active and not self._ended.is_set():
                time.sleep(_POLL_S)
            time.sleep(_SEEN_S)
            with self._lock:  # faults that wait for further replies would still drop or falsify these
                for channel in CHANNELS if not self._ended.is_set() else ():
                    self._rig.fault(channel, None, "drop_next", 0)
                    self._rig.fault(channel, None, "reading", False)
            yield
        finally:
            self._paused.clear()

    def began(self, injection: Injection) -> None:
        """Record in the rig's log that this injection happens now."""
        self.injected[injection.kind] += 1
        self.log.append((time.monotonic(), injection))
        logger.info("%s", injection)
        fields = {"injection": injection.number, "what": injection.kind, "channel": injection.channel}
        fields |= {"motor": injection.motor, "value": injection.value, "seconds": injection.seconds}  # type: ignore[dict-item]
        with self._lock:
            self._rig.log("injected", **fields)

    def _inject(self, injection: Injection) -> None:
        if injection.kind in _FOR_CALLER:
            self.for_caller.put(injection)
            return
        pid = 0
        if injection.kind in _SIGNALS:
            pid = self._control_pid(injection.channel)
            if not pid:
                self.injected[f"{injection.kind}, but there was none"] += 1
                return
        with self._lock:
            self.began(injection)
            self._apply(injection, pid)
            if injection.seconds and injection.kind != "push":
                self._active.append((time.monotonic() + injection.seconds, injection))
            else:
                self._rig.log("undone", injection=injection.number)

    def _apply(self, injection: Injection, pid: int) -> None:
        rig, channel, kind = self._rig, injection.channel, injection.kind
        row = RANDOM[kind]
        if row.rig:
            value = True if injection.value is None else injection.value
            rig.fault(channel, injection.motor or None, row.rig, value, **row.details)
        elif kind == "emergency_stop":
            EmergencyStop().latch("soak")
        elif kind == "push":
            rig.push(channel, injection.motor, injection.value, injection.seconds)
        elif kind in _SIGNALS:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, _SIGNALS[kind])
        else:
            raise ValueError(kind)

    def _undo(self, injection: Injection) -> None:
        row = RANDOM[injection.kind]
        if row.rig:
            self._rig.fault(injection.channel, injection.motor or None, row.rig, row.usual)
        elif injection.kind == "emergency_stop":
            EmergencyStop().release()
        self._rig.log("undone", injection=injection.number)

    def _control_pid(self, channel: str) -> int:
        """Return the pid of the control process that drives a channel, not of its stand-by; 0 if there is none."""
        record = newest_record(self._keys[channel])
        pid = 0 if record is None else int(record["owner_pid"])
        try:
            fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            return 0
        return pid if int(fields[1]) == os.getpid() and fields[0] not in "ZT" else 0

    def end(self) -> None:
        """Stop the thread and undo all faults. Idempotent."""
        self._ended.set()
        if self.is_alive():
            self.join()
        self._rig.close()
