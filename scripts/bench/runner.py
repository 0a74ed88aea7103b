"""Benchmark side of a measurement: a rig, a driver in a separate process, and measured periods and CPU times."""

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from recorders import stamp_temperatures

from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.rig.control import RigControl, running_rig

CHANNEL = "follower_left"  # channel whose ticks are timed
_BLOCK_S = 10.0  # interval between readings of the rig's trace, each of which delays the rig slightly
_SCRIPTS = Path(__file__).parents[1]
_TIMEOUT_S = 120.0


class BenchError(YamError):
    """Failure of a driver under measurement."""


class Subject:
    """A driver in a separate process, connected to a rig.

    Args:
        rig: name of the rig.
        job: description from which `bench.subject` creates the driver.
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

    def request(self, do: str, **arguments: Any) -> dict[str, Any]:
        """Send a request to the driver and return the reply.

        Raises:
            BenchError: the request failed; the message includes the end of the driver's log.
        """
        self._send(do, arguments)
        return self._receive()

    @contextlib.contextmanager
    def hogging(self) -> Iterator[None]:
        """Keep the interpreter of the driver's caller busy inside the block."""
        self.request("hog")
        try:
            yield
        finally:
            os.kill(self.pid, signal.SIGUSR1)
            self._receive()

    def loop_pid(self) -> int:
        """Return the pid of our control loop, a child of the driver's process; without one, the driver's own pid."""
        return _child(self.pid, b"control_process") or self.pid

    def processes(self) -> dict[str, int]:
        """Return the pids of caller, control process and stand-by."""
        loop = self.loop_pid()
        return {"caller": self.pid, "control": loop, "stand_by": _child(loop, b"") or loop}

    def close(self) -> None:
        """Disconnect the driver and end the process, by force if necessary."""
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

    def _receive(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        if not select.select([self._process.stdout], [], [], _TIMEOUT_S)[0]:
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


def _child(pid: int, named: bytes) -> int | None:
    for path in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            parent = int((path / "stat").read_text().rsplit(")", 1)[1].split()[1])
            if parent == pid and named in (path / "cmdline").read_bytes():
                return int(path.name)
    return None


@contextlib.contextmanager
def driver(
    kind: str, latency_s: float = 0.0, scene: str | None = None, **job: Any
) -> Iterator[tuple[RigControl, Subject]]:
    """Start a driver on a separate rig; end both when the block is left."""
    with running_rig(scene=scene, latency_s=latency_s) as rig:
        stamp_temperatures(rig)
        subject = Subject(rig.name, {"kind": kind, **job})
        try:
            subject.request("start")
            yield rig, subject
        finally:
            subject.close()


def tick_times(rig: RigControl, motors: int = 7) -> list[float]:
    """Return the times at which each tick's first command arrived at the rig since the trace was started.

    Includes only ticks in which every motor received its command: a driver that fills the wire's queue loses frames.
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


def measure_periods(rig: RigControl, seconds: float, during: Callable[[float], None] = time.sleep) -> np.ndarray:
    """Return the control loop's tick periods, (n,) ms. `during(seconds)` must block for that long."""
    found, left_s = [np.zeros(0)], seconds
    while left_s > 0.0:
        rig.trace_start(CHANNEL)
        during(min(left_s, _BLOCK_S))
        found.append(np.diff(tick_times(rig)) * 1e3)
        left_s -= _BLOCK_S
    return np.concatenate(found)


def cpu_s(pid: int) -> float:
    """Return the CPU time of all threads of a process, s, with a resolution of 1 ns (/proc/PID/task/*/schedstat)."""
    return sum(int(path.read_text().split()[0]) for path in Path(f"/proc/{pid}/task").glob("*/schedstat")) * 1e-9


def percentiles(values: np.ndarray, shares: Sequence[float]) -> dict[str, float]:
    """Return {"p50": …, …, "max": …} of the values; NaN if there are no values."""
    names = [f"p{share:g}".replace(".", "") for share in shares]
    if len(values) == 0:
        return dict.fromkeys([*names, "max"], float("nan"))
    found = {name: float(np.percentile(values, share)) for name, share in zip(names, shares, strict=True)}
    return {**found, "max": float(values.max())}
