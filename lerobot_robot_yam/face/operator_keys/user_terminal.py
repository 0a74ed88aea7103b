"""The user's terminal: what is typed into it, and its mode, which is given back whatever ends this process."""

import contextlib
import os
import select
import subprocess
import sys
import termios
from pathlib import Path

from lerobot_robot_yam.face.operator_keys import terminal_guard

_GUARD_END_S = 2.0
_CHUNK = 1024
_SPLIT_S = 0.02  # a slow line splits the sequence of an arrow key; LeRobot waits as long for the rest
_SPLIT = (b"\x1b", b"\x1b[", b"\x1bO")
_END_OF_INPUT = b"\x04"  # Ctrl-D: the terminal tells it as an empty line


class UserTerminal:
    """The terminal behind a descriptor. Does nothing while this process is in the background of a shell.

    Args:
        descriptor: of the terminal, which the caller keeps open.
    """

    def __init__(self, descriptor: int):
        self.descriptor = descriptor
        self.mode = termios.tcgetattr(descriptor)  # to give back
        self._ours = self.mode
        self._guard: subprocess.Popen[bytes] | None = None
        self._gone = False

    def typed(self, within_s: float) -> bytes:
        """What has been typed, empty after `within_s` without anything. A key of several bytes comes whole."""
        typed = self._read(within_s)
        while typed.endswith(_SPLIT) and (rest := self._read(_SPLIT_S)):
            typed += rest
        return typed

    def _read(self, within_s: float) -> bytes:
        poll = select.poll()
        poll.register(self.descriptor, select.POLLIN)
        with contextlib.suppress(OSError):
            for _, event in poll.poll(within_s * 1e3):
                # A terminal that has hung up can be read, too, and tells the end of input for ever.
                self._gone = bool(event & (select.POLLHUP | select.POLLERR | select.POLLNVAL))
                if self.reachable:
                    return os.read(self.descriptor, _CHUNK) or _END_OF_INPUT
        return b""

    @property
    def gone(self) -> bool:
        """It was closed."""
        return self._gone

    @property
    def reachable(self) -> bool:
        """Whether it can be read and set: a shell's background job would be stopped for trying."""
        try:
            return not self._gone and os.tcgetpgrp(self.descriptor) == os.getpgrp()
        except OSError:  # it is no shell's that has started us: nobody minds
            return not self._gone

    def set_mode(self, mode: list) -> None:
        """Put the terminal into a mode; and again, if that is not the user's, and a shell has set another meanwhile."""
        with contextlib.suppress(termios.error, OSError):
            if not self.reachable:
                return
            if mode == self._ours and (mode == self.mode or termios.tcgetattr(self.descriptor) == mode):
                return
            self._tell_guard(mode)
            termios.tcsetattr(self.descriptor, termios.TCSANOW, mode)
            self._ours = termios.tcgetattr(self.descriptor)
            if self._ours != mode:
                self._tell_guard(self._ours)

    def _tell_guard(self, ours: list) -> None:
        """Let the guard know what to undo; it is started when there is something."""
        if self._guard is None:
            terminal = os.dup(self.descriptor)  # the guard's 0 is the pipe
            try:
                self._guard = subprocess.Popen(
                    [sys.executable, "-I", "-S", terminal_guard.__file__, str(terminal), str(os.getpid())],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    cwd=Path("/"),
                    pass_fds=[terminal],
                    start_new_session=True,  # what is meant for this process's group is not for it
                )
            finally:
                os.close(terminal)
        assert self._guard.stdin is not None
        with contextlib.suppress(OSError):  # killed: then nobody guards
            self._guard.stdin.write(f"{self.mode!r}, {ours!r}\n".encode())
            self._guard.stdin.flush()

    def close(self) -> None:
        """Give the terminal its mode back. Idempotent."""
        if self.reachable:
            terminal_guard.restore(self.descriptor, self.mode, self._ours)
        guard, self._guard = self._guard, None
        if guard is not None:
            with contextlib.suppress(OSError):
                assert guard.stdin is not None
                guard.stdin.close()
            with contextlib.suppress(subprocess.TimeoutExpired):
                guard.wait(_GUARD_END_S)
