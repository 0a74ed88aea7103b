"""What LeRobot says aloud, written down: the program `spd-say` is one of ours."""

import os
import time

_SCRIPT = """#!/bin/sh
echo "$1" >> {path}
"""
_WAIT_S = 5.0


class Spoken:
    """Takes the place of `spd-say` for this process and what it starts.

    Args:
        directory: for its files.
        monkeypatch: undoes it.
    """

    def __init__(self, directory, monkeypatch):
        self._path = directory / "spoken.txt"
        programs = directory / "programs"
        programs.mkdir()
        script = programs / "spd-say"
        script.write_text(_SCRIPT.format(path=self._path))
        script.chmod(0o755)
        monkeypatch.setenv("PATH", f"{programs}{os.pathsep}{os.environ['PATH']}")

    def lines(self, least):
        """What was said, once it is so many lines; a moment longer, since there may be more."""
        until_s = time.monotonic() + _WAIT_S
        while len(self._read()) < least and time.monotonic() < until_s:
            time.sleep(0.02)
        time.sleep(0.2)
        return self._read()

    def _read(self):
        return self._path.read_text().splitlines() if self._path.exists() else []
