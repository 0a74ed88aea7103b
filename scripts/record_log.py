"""Output of a recording: the complete output goes to a file, the relevant lines to the screen."""

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

_QUIET_S = 0.2  # silence that ends the reading, s: after the recording other processes may still report landing arms
_CHUNK = 65536  # bytes
_CLEAR = b"\r\x1b[K"
# "INFO 2026-11-28 12:53:28 sode_log.py:229 episode 0: …", the format of LeRobot and of our control loops.
_RECORD = re.compile(r"(DEBUG|INFO|WARNING|ERROR|CRITICAL) \d{4}-\d\d-\d\d \d\d:\d\d:\d\d +(\S+) (.*)")
_DETAILS = re.compile(r"lerobot_robot_yam\.control\.|t_record\.py:")  # from the control loops; LeRobot's config dump
# Not shown: an episode's line already counts its late frames, the last lines name the kept episodes, and without known
# gripper stops a virtual rig cannot pinch a finger.
_LEFT_OUT = re.compile(r"Record loop is running slower|kept |\w+: no gripper stops are known")
_NOISE = re.compile(r"\[\w+ @ 0x[0-9a-f]+\]|.*\d%\|")  # settings of a video encoder; a completed progress bar
_NUMBER = re.compile(r"\d[\d.]*")


class RecordLog:
    """Shows and logs the standard error of a child process.

    The child's standard error is a terminal if the standard error of this process is one.

    Warnings that differ only in their numbers are shown once. A line with an unknown format is shown.

    Args:
        path: log file; an existing file is continued.
    """

    def __init__(self, path: Path):
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = open(path, "ab", buffering=0)
        self._screen = sys.stderr.fileno()
        self._is_terminal = os.isatty(self._screen)
        self._rest = b""
        self._live = False  # whether the next line replaces the screen's last line
        self._shows = True  # whether the present record is shown; its further lines begin with a blank
        self._warnings = Counter[tuple[str, str]]()

    @property
    def left_out(self) -> int:
        """Number of warnings that were not shown because a similar one had been shown."""
        return self._warnings.total() - len(self._warnings)

    def start(self, command: list[str]) -> subprocess.Popen[bytes]:
        """Start the child process."""
        self._source, theirs = pty.openpty() if self._is_terminal else os.pipe()
        if self._is_terminal:
            tty.setraw(theirs)  # line ends stay as in a file
            termios.tcsetwinsize(theirs, termios.tcgetwinsize(self._screen))
        child = subprocess.Popen(command, stderr=theirs)
        os.close(theirs)
        return child

    def follow(self, child: subprocess.Popen[bytes]) -> int:
        """Show and log the child's output until the child has ended; return its exit status."""
        while True:
            if select.select([self._source], [], [], _QUIET_S)[0]:
                try:
                    data = os.read(self._source, _CHUNK)
                except OSError:  # a terminal reports this way that it has no writer any more
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
        with suppress(OSError):  # a full disk must not end a recording
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
        """Return the text to show for a line, empty for nothing."""
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
        with suppress(OSError):  # the terminal was closed, but the arms must still land
            os.write(self._screen, data)
