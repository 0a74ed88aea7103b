"""Terminal input of commands that are driven by single keys."""

import contextlib
import os
import re
import select
import sys
import termios
import tty
from collections.abc import Iterator
from contextlib import contextmanager

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.signals import end_session_on_signals

QUIT = ("q", "\x04", "\x1a")  # keys that end a command: q, Ctrl-D, Ctrl-Z
UP, DOWN, RIGHT, LEFT = "\x1b[A", "\x1b[B", "\x1b[C", "\x1b[D"
_CC = 6  # index of the control characters in the list that tcgetattr returns
_KEY = re.compile(r"\x1b\[[A-D]|[\s\S]")  # an arrow key, or any single character, Escape included
_CHUNK = 1024  # maximum bytes per read
_SPLIT_S = 0.02  # wait for the rest of an arrow key's sequence, s: a slow connection may split the sequence
_SPLIT = (b"\x1b", b"\x1b[", b"\x1bO")


class KeyTerminal:
    """Terminal reader that returns single keys.

    Args:
        descriptor: file descriptor of the terminal; the caller keeps it open.

    Attributes:
        gone: whether the terminal was closed.
    """

    def __init__(self, descriptor: int):
        self._descriptor = descriptor
        self.gone = False

    def keys(self, within_s: float) -> list[str]:
        """Return the keys typed next; empty if none within `within_s`. An arrow is one key, such as `\\x1b[A`."""
        typed = self._read(within_s)
        while typed.endswith(_SPLIT) and (rest := self._read(_SPLIT_S)):
            typed += rest
        return _KEY.findall(typed.decode(errors="replace"))

    def _read(self, within_s: float) -> bytes:
        if self.gone or not select.select([self._descriptor], [], [], within_s)[0]:
            return b""
        with contextlib.suppress(OSError):
            if typed := os.read(self._descriptor, _CHUNK):
                return typed
        self.gone = True  # stop reading: each read of a closed terminal is empty or fails
        return b""


@contextmanager
def key_terminal() -> Iterator[KeyTerminal]:
    """Switch the terminal to deliver each key at once. The terminal's mode is restored when the block ends.

    SIGTERM and SIGHUP end the block like Ctrl-C.

    Raises:
        ConfigError: the command runs in the background of a shell, where reading a key would suspend it.
    """
    descriptor = sys.stdin.fileno()
    with contextlib.suppress(OSError):  # fails if no shell controls the terminal and could suspend this process
        if os.tcgetpgrp(descriptor) != os.getpgrp():
            raise ConfigError("this command is driven by keys: run it in the foreground, without &")
    undo = end_session_on_signals()
    before = termios.tcgetattr(descriptor)
    try:
        mode = termios.tcgetattr(descriptor)
        tty.cfmakecbreak(mode)
        mode[_CC][termios.VSUSP] = b"\0"  # disables Ctrl-Z: a suspended program would let the arm fall
        termios.tcsetattr(descriptor, termios.TCSANOW, mode)
        yield KeyTerminal(descriptor)
    finally:
        with contextlib.suppress(termios.error):  # the terminal may be closed
            termios.tcsetattr(descriptor, termios.TCSANOW, before)
        undo()
