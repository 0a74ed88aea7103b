"""The terminal of a command that is driven by single keys."""

import re
import sys
import termios
import tty
from collections.abc import Iterator
from contextlib import contextmanager

from lerobot_robot_yam.face.operator_keys.user_terminal import UserTerminal
from lerobot_robot_yam.system.signals import end_session_on_signals

QUIT = ("q", "\x04", "\x1a")  # Ctrl-D and Ctrl-Z, too
_CC = 6  # the characters, among what tcgetattr returns
_KEY = re.compile(r"\x1b\[[A-D]|[\s\S]")  # an arrow, or one character, Escape too


@contextmanager
def key_terminal() -> Iterator[UserTerminal]:
    """The terminal, set to give each key at once; it is given back whatever ends the block, a kill included.

    SIGTERM and SIGHUP end the block like Ctrl-C.
    """
    undo = end_session_on_signals()
    terminal = UserTerminal(sys.stdin.fileno())
    try:
        mode = termios.tcgetattr(sys.stdin.fileno())
        tty.cfmakecbreak(mode)
        mode[_CC][termios.VSUSP] = b"\0"  # a program that is stopped by Ctrl-Z lets the arm fall
        terminal.set_mode(mode)
        yield terminal
    finally:
        terminal.close()
        undo()


def typed_keys(terminal: UserTerminal, within_s: float) -> list[str]:
    """The keys that are typed next, none after `within_s`. An arrow is one key, such as `\\x1b[A`."""
    return _KEY.findall(terminal.typed(within_s).decode(errors="replace"))
