"""What an installation is at, on a terminal in one line that changes, elsewhere in a line now and then."""

import re
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Self, TextIO

_QUIET_S = 20.0  # elsewhere than on a terminal: a sign of life at least this often
_LARGE_MB = 20.0  # downloads from here on are named
_DOWNLOAD = re.compile(r"Downloading (?:\S*/)?(\S+?)-(\d\S*?)-\S*\.whl \(([\d.]+) (kB|MB|GB)\)")
_INSTALL = re.compile(r"Installing collected packages: (.*)")
_IN_MB = {"kB": 1e-3, "MB": 1.0, "GB": 1e3}
_WARNINGS = 3  # that are shown: some come once for every package
_TAIL = 30  # lines of pip's that are shown when it fails without an error of its own


class Progress:
    """Says what is going on and since when."""

    def __init__(self, stream: TextIO):
        self._stream = stream
        self._terminal = stream.isatty()
        self._begun = self._shown = time.monotonic()
        self._step = ""
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._live, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def say(self, text: str) -> None:
        """A line that stays."""
        with self._lock:
            self._write(text)

    def step(self, text: str, worth_a_line: bool = True) -> None:
        """What goes on from now; elsewhere than on a terminal it gets a line if it is worth that, or takes long."""
        with self._lock:
            self._step = text
            if text and (worth_a_line or self._terminal):
                self._show()

    def end(self) -> None:
        """All is done."""
        self.step("", worth_a_line=False)
        self.say(f"installed in {self._elapsed()}")

    def _live(self) -> None:
        while not self._over.wait(1.0 if self._terminal else _QUIET_S / 4):
            with self._lock:
                if self._step and (self._terminal or time.monotonic() - self._shown > _QUIET_S):
                    self._show()

    def _show(self) -> None:
        line = f"{self._elapsed()}  {self._step}"
        if self._terminal:
            self._stream.write(f"\r\x1b[Kscripts/run: {line}")
            self._stream.flush()
        else:
            self._write(line)

    def _write(self, text: str) -> None:
        self._shown = time.monotonic()
        self._stream.write(f"{chr(13) + chr(27) + '[K' if self._terminal else ''}scripts/run: {text}\n")
        self._stream.flush()

    def _elapsed(self) -> str:
        seconds = int(time.monotonic() - self._begun)
        return f"{seconds // 60}:{seconds % 60:02d}"


def run_pip(arguments: list[str], progress: Progress, log: Path) -> int:
    """Run pip, show its steps, its warnings and errors, and keep all that it says in a file; returns its status."""
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", *arguments]
    lines: list[str] = []
    failed, warnings, total_mb = False, 0, 0.0
    progress.step("looking for what is needed")
    with (
        open(log, "w") as file,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace") as pip,
    ):
        assert pip.stdout is not None
        for line in pip.stdout:
            file.write(line)
            lines.append(line.rstrip())
            failed = failed or line.lstrip().lower().startswith("error")
            if failed:
                progress.say(lines[-1])
            elif line.startswith("WARNING"):
                warnings += 1
                if warnings <= _WARNINGS:
                    progress.say(lines[-1])
            elif found := _DOWNLOAD.search(line):
                size_mb = float(found[3]) * _IN_MB[found[4]]
                total_mb += size_mb
                progress.step(f"downloading {found[1]} {found[2]} ({size_mb:.0f} MB)", size_mb >= _LARGE_MB)
            elif found := _INSTALL.search(line):
                count = found[1].count(",") + 1
                progress.step(f"unpacking {count} packages, {total_mb:.0f} MB of them downloaded just now")
    if warnings > _WARNINGS:
        progress.say(f"{warnings - _WARNINGS} more warnings of pip are in {log}")
    if pip.returncode and not failed:
        for line in lines[-_TAIL:]:
            progress.say(line)
    if pip.returncode:
        progress.say(f"the installation has failed; all that pip has said is in {log}")
    return pip.returncode
