"""Waiting: in real time for what other processes and threads do, or in no time by a clock of its own."""

import time

_LOOK_S = 0.01
_TAIL = 4000  # characters of a long text


def wait(condition, within_s=20.0, why="", process=None):
    """Return what `condition` returns once that is true.

    Args:
        condition: without arguments.
        within_s: after which the test fails.
        why: what to say then: a text, or a function that returns it.
        process: the test fails when this one has ended before, a `Popen`.
    """
    deadline = time.monotonic() + within_s
    while not (found := condition()):
        ended = process is not None and process.poll() is not None and not condition()
        if ended or time.monotonic() > deadline:
            text = why if isinstance(why, str) else str(why())
            raise AssertionError(f"{'it has ended' if ended else f'not within {within_s} s'}: {text[-_TAIL:]}")
        time.sleep(_LOOK_S)
    return found


class QuickClock:
    """A clock on which waiting takes no time."""

    def __init__(self):
        self.now_s = 100.0

    def now(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds
