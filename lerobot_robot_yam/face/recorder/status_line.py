"""One line at the bottom of a terminal that says how the recording goes; lines of the log push it down."""

import logging
import sys
from typing import TextIO

_CLEAR = "\r\x1b[K"


class StatusLine(logging.Filter):
    """Shown only where there is a terminal. Lets every record of the log pass, after the line is cleared.

    Args:
        stream: where the log goes, too.
    """

    def __init__(self, stream: TextIO | None = None):
        super().__init__()
        self._stream = stream or sys.stderr
        self._on = self._stream is not None and self._stream.isatty()  # a program may run without any
        self._shown = False

    def begin(self) -> None:
        """Watch the log from now on."""
        for handler in logging.getLogger().handlers if self._on else ():
            handler.addFilter(self)

    def show(self, text: str) -> None:
        """Replace what is shown. The cursor goes back: what others print replaces it, too."""
        if self._on:
            self._write(f"{_CLEAR}{text}\r")
            self._shown = self._on

    def _write(self, text: str) -> None:
        """Never fails: a terminal may be gone while arms have to land, and a signal may strike in the middle."""
        try:
            self._stream.write(text)
            self._stream.flush()
        except (OSError, ValueError, RuntimeError):
            self._on = False

    def filter(self, record: logging.LogRecord) -> bool:
        """Clear the line for a record of the log."""
        self.clear()
        return True

    def clear(self) -> None:
        """Show nothing."""
        if self._shown:
            self._shown = False
            self._write(_CLEAR)

    def end(self) -> None:
        """Clear the line, and leave the log alone."""
        self.clear()
        for handler in logging.getLogger().handlers:
            handler.removeFilter(self)
