"""Channel between a LeRobot command and a page that shows it: a file with the command's status, a socket for requests.

    desk-PID.json   the status; replaced as a whole
    desk-PID.sock   receives requests, one datagram each: {"meaning": "next", "by": "yam-view", "turn": 12.3}

Both lie in this user's runtime directory. A socket whose process is gone refuses connections. So files left behind are
recognised even if their process number is in use again, or belongs to another container.
"""

import atexit
import contextlib
import json
import os
import socket
import stat
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from lerobot_robot_yam.system.runtime_files import DESK

_STATUS, _SOCKET = ".json", ".sock"
_LONGEST = 512  # longest request, bytes
_MOST = 16  # requests read at once, at most; more wait in the kernel, which refuses their sender when full
_STATUS_BYTES = 1 << 16  # largest part of a status that is read


class Asked(NamedTuple):
    """Request to a LeRobot command.

    Attributes:
        meaning: name of a button, see `Meaning` in `face/lerobot_command/running_command.py`; not checked here.
        by: program that sends the request.
        turn: run of the command's loop that the page has shown; None: any.
    """

    meaning: str
    by: str
    turn: float | None


class DeskPost:
    """Command's end of the channel; a process has one.

    Args:
        directory: the runtime directory.

    Raises:
        OSError: the socket cannot be made.
    """

    def __init__(self, directory: Path):
        forget_the_dead(directory)
        self._status, self._path = (directory / f"{DESK}{os.getpid()}{ending}" for ending in (_STATUS, _SOCKET))
        self._path.unlink(missing_ok=True)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            self._socket.bind(str(self._path))
            self._path.chmod(stat.S_IRUSR | stat.S_IWUSR)
        except OSError:
            self._socket.close()
            raise
        self._owner = os.getpid()
        atexit.register(self.close)  # after a second Ctrl-C, which ends LeRobot's commands anywhere

    def tell(self, status: Mapping[str, Any]) -> None:
        """Replace the status. Raises OSError: the file cannot be written."""
        aside = self._status.with_name(f".{self._status.name}")
        aside.write_text(json.dumps(status))
        aside.replace(self._status)

    def asked(self, within_s: float) -> tuple[list[Asked], int]:
        """Wait for requests. Return up to `_MOST` of them, and the number of malformed datagrams."""
        found, malformed = [], 0
        self._socket.settimeout(within_s)
        with contextlib.suppress(TimeoutError, BlockingIOError):
            for _ in range(_MOST):
                data = self._socket.recv(_LONGEST + 1)
                self._socket.settimeout(0.0)
                request = _parsed(data)
                if request is not None:
                    found.append(request)
                elif data:
                    malformed += 1
        return found, malformed

    def wake(self) -> None:
        """End a running wait for requests."""
        _send(self._path, b"")

    def close(self) -> None:
        """Remove both files. Idempotent; a forked child only closes the socket."""
        atexit.unregister(self.close)
        for path in (self._status, self._path) if os.getpid() == self._owner else ():
            with contextlib.suppress(OSError):
                path.unlink()
        self._socket.close()


def _parsed(data: bytes) -> Asked | None:
    try:
        given = json.loads(data)
        asked = Asked(given["meaning"], given["by"], given.get("turn"))
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None
    texts = isinstance(asked.meaning, str) and isinstance(asked.by, str) and asked.by.isprintable()
    return asked if texts and len(data) <= _LONGEST and isinstance(asked.turn, float | int | None) else None


def running_desks(directory: Path) -> dict[int, dict[str, Any]]:
    """Read process number -> status of every running command; `age_s` is added, the age of the status."""
    found = {}
    for path in sorted(directory.glob(f"{DESK}*{_STATUS}")):
        number = path.name.removeprefix(DESK).removesuffix(_STATUS)
        if number.isdecimal() and _answers(path.with_suffix(_SOCKET)):
            status = _read(path)
            if status is not None:
                found[int(number)] = status
    return found


def _read(path: Path) -> dict[str, Any] | None:
    try:
        with open(path, "rb") as file:
            status = json.loads(file.read(_STATUS_BYTES))
            age_s = time.time() - os.fstat(file.fileno()).st_mtime
    except (OSError, ValueError, RecursionError):
        return None
    return {**status, "age_s": max(age_s, 0.0)} if isinstance(status, dict) else None


def ask(directory: Path, number: int, asked: Asked) -> bool:
    """Send a request to the command with this process number, without waiting; return whether it was sent."""
    return _send(directory / f"{DESK}{number}{_SOCKET}", json.dumps(asked._asdict()).encode())


def _send(path: Path, data: bytes) -> bool:
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ours:
        ours.setblocking(False)
        ours.sendto(data, str(path))
        return True
    return False


def forget_the_dead(directory: Path) -> None:
    """Remove the files of dead processes."""
    for path in directory.glob(f"{DESK}*{_SOCKET}"):
        if not _answers(path):
            for left in (path.with_suffix(_STATUS), path):
                with contextlib.suppress(OSError):
                    left.unlink()


def _answers(path: Path) -> bool:
    """Return whether a process has this socket open."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ours:
        try:
            ours.connect(str(path))
        except OSError:
            return False
    return True
