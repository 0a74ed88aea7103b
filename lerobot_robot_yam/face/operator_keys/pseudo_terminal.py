"""A terminal for LeRobot's key listener to read: what the user types, and the keys that handles press.

LeRobot's listener reads `sys.stdin`, if that is a terminal, when it starts: after the teleoperator has connected. So a
pseudo-terminal takes the place of `sys.stdin` meanwhile. Descriptor 0 stays what it is, for child processes. What is
typed goes on into the pseudo-terminal, and its mode, which the listener sets, is the mode of the user's terminal.
Ctrl-C remains a matter of the user's terminal.

A pipe or a file on standard input is not read: its text may be meant for others, and contain any key.
"""

import atexit
import contextlib
import os
import sys
import termios
import threading
import time
from collections.abc import Callable
from typing import TextIO

from lerobot_robot_yam.face.operator_keys.user_terminal import UserTerminal

_LOOK_S = 0.03  # between two looks at the mode
_AFTER_ESC_S = 0.06  # LeRobot takes what follows an Esc within 20 ms for a part of it
_BYTES = {
    "up": b"\x1b[A",
    "down": b"\x1b[B",
    "right": b"\x1b[C",
    "left": b"\x1b[D",
    "esc": b"\x1b",
    "enter": b"\n",
    "tab": b"\t",
    "space": b" ",
    "backspace": b"\x7f",
}
_END_S = 1.0  # somebody else may have read what it was to read
_ECHO_AT = 3  # the place of the local flags in a mode
_the_one: "PseudoTerminal | None" = None


class PseudoTerminal:
    """One for this process. LeRobot uses it until it has stopped its listener, which is after all devices are gone.

    Attributes:
        heard: called, by the thread that carries it over, with what the user has typed.
    """

    def __init__(self) -> None:
        self._master, self._slave = os.openpty()
        os.set_blocking(self._master, False)
        self._file = open(self._slave, errors="replace", closefd=False)
        self._before: TextIO | None = None
        self._user: UserTerminal | None = None
        self._relay: threading.Thread | None = None
        self._writing = threading.Lock()
        self._free_s = 0.0  # when the next byte may be written
        self._typed_esc = False  # the Esc that it has to wait for was typed
        self._users, self._process = 0, os.getpid()
        self.heard: Callable[[bytes], None] = lambda typed: None

    def take(self) -> None:
        """Be `sys.stdin` from now on."""
        self._users += 1
        if self._users > 1:
            return
        self._before = sys.stdin
        terminal = _terminal_of(self._before)
        mode = termios.tcgetattr(self._slave)
        if terminal is not None:
            self._user = UserTerminal(terminal)
            mode = self._user.mode
        else:
            mode[_ECHO_AT] &= ~termios.ECHO  # nobody reads what it would say
        termios.tcsetattr(self._slave, termios.TCSAFLUSH, mode)
        sys.stdin = self._file
        atexit.register(self._end)
        if self._user is not None:
            self._relay = threading.Thread(target=self._run, args=(self._user,), name="typed keys", daemon=True)
            self._relay.start()

    def give_back(self) -> None:
        """What was there before is `sys.stdin` again, and the user's terminal as it was."""
        self._users = max(self._users - 1, 0)
        if self._users == 0:
            self._end()

    def _end(self) -> None:
        if os.getpid() != self._process:  # a child that was forked: the terminal is its parent's
            return
        atexit.unregister(self._end)
        self._users = 0
        if sys.stdin is self._file:
            sys.stdin = self._before
        user, self._user = self._user, None
        if self._relay is not None and self._relay is not threading.current_thread():
            self._relay.join(_END_S)
        self._relay = None
        if user is not None:
            user.close()

    def press(self, key: str) -> None:
        """Press a key, by LeRobot's name of it. Never blocks for longer than 60 ms; what nobody reads is lost."""
        self._write(_BYTES.get(key) or key.encode(), typed=False)

    def _write(self, data: bytes, typed: bool) -> None:
        with self._writing:
            wait_s = self._free_s - time.monotonic()
            if wait_s > 0.0 and not (typed and self._typed_esc):  # what is typed goes on as it was typed
                time.sleep(wait_s)
            with contextlib.suppress(OSError):
                os.write(self._master, data)
            if data.endswith(b"\x1b"):
                self._free_s, self._typed_esc = time.monotonic() + _AFTER_ESC_S, typed

    def _run(self, user: UserTerminal) -> None:
        """Carry what is typed over, and the mode back, until it ends."""
        while self._user is user and not user.gone:
            user.set_mode(termios.tcgetattr(self._slave))
            if not user.reachable:
                time.sleep(_LOOK_S)
            elif typed := user.typed(_LOOK_S):
                self._write(typed, typed=True)
                self.heard(typed)
            with contextlib.suppress(OSError):
                os.read(self._master, 65536)  # its echo, which the user's terminal has shown already


def pseudo_terminal() -> PseudoTerminal:
    """The one of this process."""
    global _the_one
    if _the_one is None or _the_one._process != os.getpid():
        _the_one = PseudoTerminal()
    return _the_one


def _terminal_of(file: TextIO | None) -> int | None:
    """Descriptor of the terminal behind a file; None without one."""
    try:
        descriptor = file.fileno() if file is not None else -1
        termios.tcgetattr(descriptor)
    except (OSError, ValueError, AttributeError, termios.error):
        return None
    return descriptor
