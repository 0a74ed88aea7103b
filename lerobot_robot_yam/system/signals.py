"""SIGTERM and SIGHUP end a session like Ctrl-C; and what must not be cut short is not.

Handlers are process-wide, so they are shared by all devices of the process, set only in the main thread, only over
default handlers, and put back when the last device disconnects.
"""

import logging
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

logger = logging.getLogger(__name__)

_ENDING = (signal.SIGTERM, signal.SIGHUP)
_users = 0
_replaced: dict[signal.Signals, Any] = {}


def _end_session(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt(f"ended by {signal.Signals(number).name}")


def end_session_on_signals() -> Callable[[], None]:
    """From now on SIGTERM and SIGHUP raise KeyboardInterrupt in the main thread.

    Returns:
        A function that undoes it; calling it twice does no harm.
    """
    global _users
    _users += 1
    if threading.current_thread() is threading.main_thread():
        for number in _ENDING:
            if signal.getsignal(number) is signal.SIG_DFL:
                _replaced[number] = signal.signal(number, _end_session)
    done = False

    def undo() -> None:
        nonlocal done
        global _users
        if done:
            return
        done = True
        _users -= 1
        if _users == 0 and threading.current_thread() is threading.main_thread():
            for number, handler in _replaced.items():
                if signal.getsignal(number) is _end_session:
                    signal.signal(number, handler)
            _replaced.clear()

    return undo


@contextmanager
def undisturbed(what: str) -> Iterator[None]:
    """Inside the block SIGINT, SIGTERM and SIGHUP are answered with a word in the log, nothing else.

    Does nothing outside the main thread, where no handler can be set (and none runs).
    """

    def answer(number: int, frame: FrameType | None) -> None:
        logger.warning("%s; the arms have no brakes, so this cannot be cut short", what)

    with _answered(answer):
        yield


@contextmanager
def finished_first(what: str) -> Iterator[None]:
    """SIGINT, SIGTERM and SIGHUP that come inside the block raise KeyboardInterrupt at its end.

    Does nothing outside the main thread, where no handler can be set (and none runs).

    Raises:
        KeyboardInterrupt: one came.
    """
    came: list[str] = []

    def answer(number: int, frame: FrameType | None) -> None:
        logger.info("%s first", what)
        came.append(signal.Signals(number).name)

    with _answered(answer):
        yield
    if came:
        raise KeyboardInterrupt(f"ended by {came[0]}")


@contextmanager
def _answered(answer: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, *_ENDING)}
    try:
        for number in before:
            signal.signal(number, answer)
        yield
    finally:
        for number, handler in reversed(before.items()):  # SIGINT last: from then on it may interrupt this, too
            if handler is not None:  # None: not set from Python, cannot be put back
                signal.signal(number, handler)
