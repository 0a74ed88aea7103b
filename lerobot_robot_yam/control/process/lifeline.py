"""The line between a caller and the processes that hold its arms: each end hears when the other is gone.

A pid does not tell that: a caller that executes another program keeps its own. The kernel closes the caller's end
then, as it does however the caller ends. No program can open a socket through /proc, to keep it open or to write.
"""

import os
import select
import socket
import weakref


class Lifeline:
    """The caller's end. `far_end` is a descriptor to be inherited by the processes that hold the arms."""

    def __init__(self) -> None:
        self._near, self._far = socket.socketpair()
        _lines.add(self)

    @property
    def far_end(self) -> int:
        """Descriptor of the other end, until `hand_over`."""
        return self._far.fileno()

    def hand_over(self) -> None:
        """Close the other end here: a process that inherits it has been started."""
        self._far.close()

    @property
    def cut(self) -> bool:
        """Whether no process has the other end any more."""
        return self._near.fileno() < 0 or hung_up(self._near.fileno(), 0.0)

    def close(self) -> None:
        """Let go: the far end takes this process for gone. Idempotent."""
        self._near.close()
        self._far.close()


def hung_up(descriptor: int, within_s: float) -> bool:
    """Wait until no process has the other end of a line; False: one still has it after `within_s`."""
    poll = select.poll()
    poll.register(descriptor, select.POLLRDHUP)
    return bool(poll.poll(within_s * 1e3))


_lines: "weakref.WeakSet[Lifeline]" = weakref.WeakSet()


def _let_go() -> None:
    """A forked child must not hold its parent's end: it may live on when the parent does not."""
    for line in list(_lines):
        line.close()


os.register_at_fork(after_in_child=_let_go)
