"""Channel between a LeRobot command and a page that displays the command: status file and request socket.

    desk-PID.json   the status; replaced atomically
    desk-PID.sock   receives requests, one datagram each: {"meaning": "next", "by": "yam-view", "turn": 12.3}

Both files are in this user's runtime directory. A socket of a dead process refuses connections, so stale files are
recognised even if the pid is in use again or belongs to another container.
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
_LONGEST = 512  # maximum request size, bytes
_MOST = 16  # maximum number of requests per read; more wait in the kernel, whose full queue refuses new requests
_STATUS_BYTES = 1 << 16  # maximum number of bytes read from a status file


class Asked(NamedTuple):
    """Request to a LeRobot command.

    Attributes:
        meaning: name of a button, see `Meaning` in `face/lerobot_command/running_command.py`; not validated here.
        by: name of the program that sends the request.
        turn: start time of the loop run that the page displayed, see `running_command`; None: any run.
    """

    meaning: str
    by: str
    turn: float | None


class DeskPost:
    """The command's side of the channel; at most one per process.

    Args:
        directory: the runtime directory.

    Raises:
        OSError: the socket cannot be created.
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
        atexit.register(self.close)  # for a second Ctrl-C, which may end a LeRobot command at any point

    def tell(self, status: Mapping[str, Any]) -> None:
        """Replace the status file atomically. Raises OSError: the file cannot be written."""
        aside = self._status.with_name(f".{self._status.name}")
        aside.write_text(json.dumps(status))
        aside.replace(self._status)

    def asked(self, within_s: float) -> tuple[list[Asked], int]:
        """Wait for requests; return at most `_MOST` requests, and the number of malformed datagrams."""
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
        """Wake up a thread that waits in `asked`."""
        _send(self._path, b"")

    def close(self) -> None:
        """Remove both files; a forked child only closes the socket. Idempotent."""
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
    """Return pid -> status of every running command. The key `age_s` is added: age of the status, s."""
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
    """Send a request to the command with pid `number`, without waiting; return whether the request was sent."""
    return _send(directory / f"{DESK}{number}{_SOCKET}", json.dumps(asked._asdict()).encode())


def _send(path: Path, data: bytes) -> bool:
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ours:
        ours.setblocking(False)
        ours.sendto(data, str(path))
        return True
    return False


def forget_the_dead(directory: Path) -> None:
    """Remove status files and sockets of dead processes."""
    for path in directory.glob(f"{DESK}*{_SOCKET}"):
        if not _answers(path):
            for left in (path.with_suffix(_STATUS), path):
                with contextlib.suppress(OSError):
                    left.unlink()


def _answers(path: Path) -> bool:
    """Return whether a live process has the socket at `path` open."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ours:
        try:
            ours.connect(str(path))
        except OSError:
            return False
    return True
