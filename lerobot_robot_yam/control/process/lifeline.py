"""Mutual detection of process exit between a caller and the processes that hold its arms.

A pid is not sufficient, since a caller that executes another program keeps its pid. A socket pair is sufficient: the
kernel closes the caller's end of the socket, however the caller ends. No program can open a socket through /proc,
neither to keep the socket open nor to write.
"""

import contextlib
import os
import select
import socket
import weakref

_FLAGS_AT = 6  # index of the flags field among the fields after the name, see proc_pid_stat(5)
_PF_EXITING = 0x4  # flag of an exiting process, include/linux/sched.h


class Lifeline:
    """The caller's end of a socket pair. The processes that hold the arms inherit the descriptor `far_end`."""

    def __init__(self) -> None:
        self._near, self._far = socket.socketpair()
        _lines.add(self)

    @property
    def far_end(self) -> int:
        """Descriptor of the far end, valid until `hand_over`."""
        return self._far.fileno()

    def hand_over(self) -> None:
        """Close this process's copy of the far end, after the start of a process that inherits the far end."""
        self._far.close()

    def nudge(self) -> None:
        """Wake up a poll that waits for data at the far end. Never blocks, never fails."""
        with contextlib.suppress(OSError):  # closed, or the buffer is full of unread nudges
            self._near.send(b"\0", socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL)

    @property
    def cut(self) -> bool:
        """Whether no process has the far end open any more."""
        return self._near.fileno() < 0 or hung_up(self._near.fileno(), 0.0)

    def close(self) -> None:
        """Close both ends; readers of the far end see this process as exited. Idempotent."""
        self._near.close()
        self._far.close()


def take_nudges(descriptor: int) -> bool:
    """Read the bytes sent by `Lifeline.nudge` from a readable far end; return False if the near end is closed."""
    try:
        return bool(os.read(descriptor, 4096))
    except ConnectionResetError:
        return False


def hung_up(descriptor: int, within_s: float) -> bool:
    """Wait until no process has the other end of the socket open; return False after a timeout of `within_s`."""
    poll = select.poll()
    poll.register(descriptor, select.POLLRDHUP)
    return bool(poll.poll(within_s * 1e3))


_lines: "weakref.WeakSet[Lifeline]" = weakref.WeakSet()


def _let_go() -> None:
    """Close all lifelines in a forked child, which may outlive its parent and must not keep the parent's ends open."""
    for line in list(_lines):
        line.close()


os.register_at_fork(after_in_child=_let_go)


class ProcessEnd:
    """Exit detection for one local process by pid, earlier than the kernel's exit notification.

    The kernel reports an exit only after the process's memory is freed, 0.1 s for large or locked memory. Arms need not
    wait that long: a process executes no code from the first step of its exit on.

    Raises:
        FileNotFoundError: the process has already exited.
    """

    def __init__(self, pid: int):
        self._stat = os.open(f"/proc/{pid}/stat", os.O_RDONLY | os.O_CLOEXEC)

    def reached(self) -> bool:
        """Return whether the main thread of the process has begun to exit. Takes 10 µs."""
        try:
            fields = os.pread(self._stat, 1024, 0).rpartition(b")")[2].split()
        except ProcessLookupError:
            return True
        return bool(int(fields[_FLAGS_AT]) & _PF_EXITING)
