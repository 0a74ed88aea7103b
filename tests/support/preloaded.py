"""Runs installed commands in processes that have torch and its like loaded: each would need five seconds for that.

    python -m tests.support.preloaded FD

This process loads what LeRobot loads, but nothing of LeRobot or of ours, and forks for each command that it is asked
for over the socket FD. The child takes arguments, environment, directory and standard files of the request, and runs
the command's own script from its first line. In the long tier commands are started without it.
"""

import contextlib
import importlib
import json
import os
import random
import runpy
import select
import signal
import socket
import subprocess
import sys
import warnings
from pathlib import Path

# Whatever takes long to load before a LeRobot command begins, of other people's.
_LOADED = ("torch", "torchvision", "torch._dynamo", "scipy.spatial.transform", "pandas", "datasets", "av", "cv2")
_LOOK_S = 0.02
_REQUEST = 1 << 20


_started: "list[PreloadedCommand]" = []


def running() -> dict[int, str]:
    """Command lines of those that have been started here and have not ended, by process id."""
    return {command.pid: " ".join(command.args) for command in _started if command.poll() is None}


class Preloaded:
    """The process that forks; one for all commands of a test process."""

    def __init__(self) -> None:
        self._socket, theirs = socket.socketpair()
        environment = {name: value for name, value in os.environ.items() if not name.startswith("YAM_")}
        command = [sys.executable, "-m", "tests.support.preloaded", str(theirs.fileno())]
        with theirs:
            subprocess.Popen(command, cwd=Path(__file__).parents[2], env=environment, pass_fds=[theirs.fileno()])

    def start(
        self, arguments: list[str], cwd: Path, environment: dict[str, str], stdin: int, output: int
    ) -> "PreloadedCommand":
        """Start the script arguments[0], as the leader of a new session."""
        told, tells = os.pipe()
        request = json.dumps({"arguments": arguments, "cwd": str(cwd), "environment": environment}).encode()
        socket.send_fds(self._socket, [request], [stdin, output, tells])
        os.close(tells)
        _started.append(PreloadedCommand(int.from_bytes(self._socket.recv(4)), told, arguments))
        return _started[-1]


class PreloadedCommand:
    """What `subprocess.Popen` offers of a running command, as far as the tests ask."""

    def __init__(self, pid: int, told: int, arguments: list[str]):
        self.pid, self.args, self.returncode = pid, arguments, None
        self._told = told

    def wait(self, timeout: float | None = None) -> int:
        """Its exit status, negative for a signal. Raises TimeoutExpired."""
        if self.returncode is None:
            if not select.select([self._told], [], [], timeout)[0]:
                raise subprocess.TimeoutExpired(self.args, timeout)
            self.returncode = int.from_bytes(os.read(self._told, 4), signed=True)
            os.close(self._told)
        return self.returncode

    def poll(self) -> int | None:
        """Its exit status, None while it runs."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.wait(0.0)
        return self.returncode

    def send_signal(self, number: int) -> None:
        """Send a signal, unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def terminate(self) -> None:
        """SIGTERM."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """SIGKILL."""
        self.send_signal(signal.SIGKILL)


def _serve(requests: socket.socket) -> None:
    running: dict[int, int] = {}  # where the end of a child is told
    while True:
        if select.select([requests], [], [], _LOOK_S if running else None)[0]:
            request, files, _, _ = socket.recv_fds(requests, _REQUEST, 3)
            if not request:
                return
            pid = os.fork()
            if pid == 0:
                requests.close()
                _become(json.loads(request), *files[:2])
            for file in files[:2]:
                os.close(file)
            running[pid] = files[2]
            requests.send(pid.to_bytes(4))
        for pid in list(running):
            ended, status = os.waitpid(pid, os.WNOHANG)
            if ended:
                with contextlib.suppress(BrokenPipeError), open(running.pop(pid), "wb") as tells:
                    tells.write(os.waitstatus_to_exitcode(status).to_bytes(4, signed=True))


def _become(request: dict, stdin: int, output: int) -> None:
    """Be the command, to its end."""
    os.setsid()
    os.chdir(request["cwd"])
    for file, number in ((stdin, 0), (output, 1), (output, 2)):
        os.dup2(file, number)
    os.closerange(3, 1024)  # inherited: the ends that tell of others
    os.environ.clear()
    os.environ.update(request["environment"])
    random.seed()
    sys.argv = request["arguments"]
    here = str(Path(__file__).parents[2])
    sys.path = [entry for entry in sys.path if entry not in ("", here)]
    sys.path[:0] = [str(Path(sys.argv[0]).parent), *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))]
    for name in [name for name in sys.modules if name == "tests" or name.startswith("tests.")]:
        del sys.modules[name]
    signal.signal(signal.SIGINT, signal.default_int_handler)
    runpy.run_path(sys.argv[0], run_name="__main__")  # what it raises ends this process, as it would end the command
    sys.exit(0)


if __name__ == "__main__":
    warnings.simplefilter("ignore", DeprecationWarning)  # of forks beside threads: numpy's, which sleep
    for module in _LOADED:
        importlib.import_module(module)
    _serve(socket.socket(fileno=int(sys.argv[1])))
