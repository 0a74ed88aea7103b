"""How the processes that hold arms, and their caller, notice each other's end.

A pid does not show the end, since a caller that executes another program keeps its pid. A socket between both does: the
kernel closes the caller's end of the socket, however the caller ends. No program can open a socket through /proc, to
keep it open or to write.
"""

import contextlib
import os
import select
import socket
import weakref

_FLAGS_AT = 6  # index of the flags among the fields after the name, see proc_pid_stat(5)
_PF_EXITING = 0x4  # flag of an exiting process, include/linux/sched.h


class Lifeline:
    """The caller's end of a line. `far_end` is a descriptor to be inherited by the processes that hold the arms."""

    def __init__(self) -> None:
        self._near, self._far = socket.socketpair()
        _lines.add(self)

    @property
    def far_end(self) -> int:
        """Descriptor of the other end, until `hand_over`."""
        return self._far.fileno()

    def hand_over(self) -> None:
        """Close the other end here, after the start of a process that inherits it."""
        self._far.close()

    def nudge(self) -> None:
        """Wake up a poll of the far end that waits for data. Never waits, never fails."""
        with contextlib.suppress(OSError):  # closed; or so many nudges wait that one more is not needed
            self._near.send(b"\0", socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL)

    @property
    def cut(self) -> bool:
        """Whether no process has the other end any more."""
        return self._near.fileno() < 0 or hung_up(self._near.fileno(), 0.0)

    def close(self) -> None:
        """Close both ends; at the far end this process counts as gone. Idempotent."""
        self._near.close()
        self._far.close()


def take_nudges(descriptor: int) -> bool:
    """Read what `Lifeline.nudge` has sent to a readable far end; return False if the other end is gone."""
    try:
        return bool(os.read(descriptor, 4096))
    except ConnectionResetError:
        return False


def hung_up(descriptor: int, within_s: float) -> bool:
    """Wait until no process has the other end of a line; return False if one has after `within_s`."""
    poll = select.poll()
    poll.register(descriptor, select.POLLRDHUP)
    return bool(poll.poll(within_s * 1e3))


_lines: "weakref.WeakSet[Lifeline]" = weakref.WeakSet()


def _let_go() -> None:
    """Close all lines in a forked child, which may outlive its parent and must not hold the parent's ends."""
    for line in list(_lines):
        line.close()


os.register_at_fork(after_in_child=_let_go)


class ProcessEnd:
    """Watch on one process of this machine, by its pid, that notices its end before the kernel reports it.

    The kernel reports an end after it has cleared the memory, which takes 0.1 s for a locked or large one. Arms need
    not wait for that: a process executes nothing from the first step of its exit on.

    Raises:
        FileNotFoundError: the process has ended.
    """

    def __init__(self, pid: int):
        self._stat = os.open(f"/proc/{pid}/stat", os.O_RDONLY | os.O_CLOEXEC)

    def reached(self) -> bool:
        """Return whether the process's main thread has begun to exit. Takes 10 µs."""
        try:
            fields = os.pread(self._stat, 1024, 0).rpartition(b")")[2].split()
        except ProcessLookupError:
            return True
        return bool(int(fields[_FLAGS_AT]) & _PF_EXITING)
