"""The bench's side of a measurement: a rig, a driver in a process of its own, and the clock between them."""

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from bench.windows import WINDOW_S, Periods, Windows, periods
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.rig.client.rig_control import RigControl, running_rig

CHANNEL = "follower_left"  # where ticks are stamped
_BLOCK_WINDOWS = 10  # windows between two readings of the rig's trace, which takes the rig a moment
_PATIENCE = 3  # gives up when disturbed windows have made a measurement this many times as long
_SCRIPTS = Path(__file__).parents[1]
_TIMEOUT_S = 120.0


class BenchError(YamError):
    """A driver under measurement failed."""


class Subject:
    """A driver in a process of its own, on a rig.

    Args:
        rig: name of the rig.
        job: what `bench.subject` makes a driver from.
    """

    def __init__(self, rig: str, job: dict[str, Any]):
        self._log = tempfile.TemporaryFile("w+")
        self.name = str(job["kind"])
        self._process = subprocess.Popen(
            [sys.executable, "-m", "bench.subject", json.dumps(job)],
            cwd=_SCRIPTS,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            env={**os.environ, "YAM_RIG": rig},
            text=True,
        )
        self.pid = self._process.pid
        self._receive()

    def request(self, do: str, meanwhile: Callable[[], None] | None = None, **arguments: Any) -> dict[str, Any]:
        """Have the driver do something; returns its answer. `meanwhile` is called over and over until it is there.

        Raises:
            BenchError: it failed; with the end of its log.
        """
        self._send(do, arguments)
        if meanwhile is not None:
            while not self._readable(0.0):
                meanwhile()
        return self._receive()

    @contextlib.contextmanager
    def hogging(self) -> Iterator[None]:
        """The interpreter of the driver's caller is busy inside the block."""
        self.request("hog")
        try:
            yield
        finally:
            os.kill(self.pid, signal.SIGUSR1)
            self._receive()

    def loop_pid(self) -> int:
        """Process of our control loop, a child of the driver's caller; the caller itself if there is none."""
        for path in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                parent = int((path / "stat").read_text().rsplit(")", 1)[1].split()[1])
                if parent == self.pid and b"arm.process" in (path / "cmdline").read_bytes():
                    return int(path.name)
        return self.pid

    def close(self) -> None:
        """Disconnect and end; kills what does not end."""
        with contextlib.suppress(BenchError, OSError):
            self.request("stop")
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()
        try:
            self._process.wait(20)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
        self._log.close()

    def _send(self, do: str, arguments: dict[str, Any]) -> None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps({"do": do, **arguments}) + "\n")
            self._process.stdin.flush()
        except OSError as error:
            raise self._error(f"is gone ({error})") from error

    def _readable(self, timeout_s: float) -> bool:
        return bool(select.select([self._process.stdout], [], [], timeout_s)[0])

    def _receive(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        if not self._readable(_TIMEOUT_S):
            raise self._error(f"has not answered for {_TIMEOUT_S:.0f} s")
        line = self._process.stdout.readline()
        if not line:
            raise self._error(f"ended with status {self._process.wait()}")
        answer: dict[str, Any] = json.loads(line)
        if "error" in answer:
            raise self._error(answer["error"])
        return answer

    def _error(self, what: str) -> BenchError:
        self._log.seek(0)
        tail = "".join(self._log.readlines()[-15:])
        return BenchError(f"{self.name}: {what}\n{tail}")


@contextlib.contextmanager
def driver(kind: str, latency_s: float = 0.0, **job: Any) -> Iterator[tuple[RigControl, Subject, float]]:
    """A started driver on a rig of its own; also the seconds that its start took. Everything ends with the block."""
    with running_rig(latency_s=latency_s, stamp_temperatures=True) as rig:
        subject = Subject(rig.name, {"kind": kind, **job})
        try:
            connect_s = subject.request("start")["connect_s"]
            yield rig, subject, connect_s
        finally:
            subject.close()


def tick_times(rig: RigControl, motors: int = 7) -> list[float]:
    """When each tick's first command arrived at the rig since the trace was started.

    Only ticks in which every motor got its command: a driver that fills the wire's queue loses single frames.
    """
    ticks: list[float] = []
    begin_s, expected = 0.0, 1
    for _, arrived, ident, _ in rig.trace(CHANNEL):
        if ident == 1:
            begin_s, expected = arrived, 2
        elif ident == expected:
            expected += 1
            if expected > motors:
                ticks.append(begin_s)
                expected = 0
    return ticks


def measure_periods(
    rig: RigControl, wanted_s: float, during: Callable[[float, Callable[[], None]], None] | None = None
) -> Periods:
    """Periods of whatever commands the rig now, until `wanted_s` of undisturbed windows have been seen.

    Args:
        rig: stamps the arrival of each frame.
        wanted_s: undisturbed time to collect; gives up after `_PATIENCE` times as long.
        during: called with the length of a block in s and a function that marks window edges as time passes;
            it has to spend that time. None: just wait.
    """
    found, used_s, total_s = [np.zeros(0)], 0.0, 0.0
    while used_s < wanted_s and total_s < _PATIENCE * wanted_s:
        windows = Windows()
        count = max(1, min(_BLOCK_WINDOWS, round((wanted_s - used_s) / WINDOW_S)))
        length_s = min(WINDOW_S, wanted_s)
        rig.trace_start(CHANNEL)
        windows.mark()

        def wait(windows: Windows = windows, length_s: float = length_s) -> None:
            time.sleep(length_s)
            windows.mark()

        if during is None:
            for _ in range(count):
                wait()
        else:
            during(count * length_s, wait)
        found.append(periods(tick_times(rig), windows))
        used_s += windows.used_s
        total_s += windows.total_s
    return Periods(np.concatenate(found), used_s, total_s)


def measure_work(subject: Subject, wanted_s: float, **arguments: Any) -> tuple[np.ndarray, float, float]:
    """Have a driver get and send at a rate until `wanted_s` of undisturbed windows have been seen.

    Returns:
        (n, 3) rows of monotonic s, get + send ms, age ms, of undisturbed windows; time used, time gone by.
    """
    found, used_s, total_s = [np.zeros((0, 3))], 0.0, 0.0
    while used_s < wanted_s and total_s < _PATIENCE * wanted_s:
        windows = Windows()
        length_s = min(WINDOW_S, wanted_s)

        def wait(windows: Windows = windows, length_s: float = length_s) -> None:
            time.sleep(length_s)
            windows.mark()

        windows.mark()
        block_s = min(_BLOCK_WINDOWS * WINDOW_S, wanted_s - used_s)
        rows = np.array(subject.request("work", wait, seconds=block_s, **arguments)["rows"]).reshape(-1, 3)
        found.append(rows[windows.contains(rows[:, 0])])
        used_s += min(windows.used_s, block_s)
        total_s += windows.total_s
    return np.concatenate(found), used_s, total_s
