"""What a recording says: a file keeps all of it, the screen shows what a person needs."""

import os
import pty
import re
import select
import subprocess
import sys
import termios
import tty
from collections import Counter
from contextlib import suppress
from pathlib import Path

_QUIET_S = 0.2  # silence that ends the reading, s: after the recording others may still say that arms land
_CHUNK = 65536  # bytes
_CLEAR = b"\r\x1b[K"
# "INFO 2026-11-28 12:53:28 sode_log.py:229 episode 0: …", as LeRobot and our control loops write it.
_RECORD = re.compile(r"(DEBUG|INFO|WARNING|ERROR|CRITICAL) \d{4}-\d\d-\d\d \d\d:\d\d:\d\d +(\S+) (.*)")
_DETAILS = re.compile(r"lerobot_robot_yam\.control\.|t_record\.py:")  # of the loops; LeRobot's dump of its config
# Late frames are in the line about their episode, what is kept in the last lines; no finger can be caught in the rig.
_LEFT_OUT = re.compile(r"Record loop is running slower|kept |\w+: no gripper stops are known")
_NOISE = re.compile(r"\[\w+ @ 0x[0-9a-f]+\]|.*\d%\|")  # an encoder's settings; a progress bar that is full
_NUMBER = re.compile(r"\d[\d.]*")


class RecordLog:
    """Shows what a child process writes to its standard error, which is a terminal for the child if ours is one.

    Warnings that differ only in their numbers are shown once. A line of an unknown form is shown.

    Args:
        path: of the file; one that exists is continued.
    """

    def __init__(self, path: Path):
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = open(path, "ab", buffering=0)
        self._screen = sys.stderr.fileno()
        self._is_terminal = os.isatty(self._screen)
        self._rest = b""
        self._live = False  # the screen's last line will be replaced
        self._shows = True  # the present record, whose further lines begin with a blank
        self._warnings = Counter[tuple[str, str]]()

    @property
    def left_out(self) -> int:
        """How many warnings were not shown because one like them had been."""
        return self._warnings.total() - len(self._warnings)

    def start(self, command: list[str]) -> subprocess.Popen[bytes]:
        """Start the child."""
        self._source, theirs = pty.openpty() if self._is_terminal else os.pipe()
        if self._is_terminal:
            tty.setraw(theirs)  # its lines end as they would in a file
            termios.tcsetwinsize(theirs, termios.tcgetwinsize(self._screen))
        child = subprocess.Popen(command, stderr=theirs)
        os.close(theirs)
        return child

    def follow(self, child: subprocess.Popen[bytes]) -> int:
        """Show and keep what the child says until it has ended; returns its status."""
        while True:
            if select.select([self._source], [], [], _QUIET_S)[0]:
                try:
                    data = os.read(self._source, _CHUNK)
                except OSError:  # how a terminal says that nobody writes to it any more
                    break
                if not data:
                    break
                self._take(data)
            elif child.poll() is not None:
                break
        if self._rest:
            self._line(self._rest)
        if self._live:
            self._write(_CLEAR)
        return child.wait()

    def _take(self, data: bytes) -> None:
        with suppress(OSError):  # a full disk ends no recording
            self._file.write(data)
        *parts, self._rest = re.split(rb"(?<=[\r\n])", self._rest + data)
        for part in parts:
            text = part.rstrip(b"\r\n").replace(b"\x1b[K", b"")
            if part.endswith(b"\n"):
                self._line(text)
            elif text and self._is_terminal:
                self._write(_CLEAR + text + b"\r")
                self._live = True

    def _line(self, line: bytes) -> None:
        text = line.decode(errors="replace")
        if shown := self._shown(text):
            self._write((_CLEAR if self._live else b"") + shown.encode() + b"\n")
            self._live = False

    def _shown(self, line: str) -> str:
        """What the screen shows of a line, empty for nothing."""
        record = _RECORD.match(line)
        if record is None:
            if not line[:1].isspace():
                self._shows = not _NOISE.match(line)
            return line if self._shows else ""
        level, place, text = record.groups()
        self._shows = not _LEFT_OUT.match(text)
        if level in ("DEBUG", "INFO"):
            self._shows = self._shows and not _DETAILS.match(place)
            return text if self._shows else ""
        if level == "WARNING" and self._shows:
            kind = (place, _NUMBER.sub("", text))
            self._warnings[kind] += 1
            self._shows = self._warnings[kind] == 1
        return f"{level.lower()}: {text}" if self._shows else ""

    def _write(self, data: bytes) -> None:
        with suppress(OSError):  # the terminal was closed; the arms have to land
            os.write(self._screen, data)
