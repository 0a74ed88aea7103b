"""Signals: SIGTERM and SIGHUP end a session as Ctrl-C does, with a message of one line; some code blocks finish first.

Under a LeRobot command, errors of this package are printed as one line, too: the line states what failed and what to
do, which a traceback would hide.

Handlers are process-wide, so all devices of the process share them. They are set only in the main thread and only in
place of default handlers, and restored when the last device disconnects.
"""

import importlib.util
import logging
import math
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Any

from lerobot_robot_yam.errors import YamError

logger = logging.getLogger(__name__)

_DEFAULTS = {
    signal.SIGINT: signal.default_int_handler,
    signal.SIGTERM: signal.SIG_DFL,
    signal.SIGHUP: signal.SIG_DFL,
}
_WHY = "ended by "  # first words of a KeyboardInterrupt from this module
# Module that torch, if installed, imports at exit. An import that late makes Python forget that an interrupt ended the
# process, and the exit status becomes 1. So this module imports it early.
_LOADED_AT_EXIT = "tabulate"
_TWICE_S = 1.0  # period in which several signals count as one, s: a closed terminal sends two at once
_users = 0  # number of devices that have not yet undone their `end_session_on_signals`
_waits = False  # whether the session will end by itself
_under_a_command = False
_first_s = -math.inf  # monotonic time of the first signal
_replaced: dict[signal.Signals, Any] = {}
_report: Any = sys.excepthook  # previous hook for uncaught exceptions

Instead = Callable[[FrameType | None, str], bool]
"""Function of the interrupted frame and the reason; returns whether the session will end without an exception."""
_instead: list[Instead] = []


def _end_session(number: int, frame: FrameType | None) -> None:
    global _first_s, _waits
    why = f"{_WHY}{signal.Signals(number).name}"
    now_s = time.monotonic()
    if math.isinf(_first_s):
        _first_s = now_s
        _waits = any(instead(frame, why) for instead in _instead)
    if not _waits or now_s - _first_s > _TWICE_S:
        raise KeyboardInterrupt(why)


def _say_in_a_line(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    if issubclass(kind, KeyboardInterrupt) and str(error).startswith(_WHY):
        sys.stderr.write(f"{error}\n")
    elif issubclass(kind, YamError) and _under_a_command:
        logger.debug("where it happened:", exc_info=(kind, error, trace))
        sys.stderr.write(f"error: {error}\n")
    else:
        _report(kind, error, trace)


def end_session_on_signals(instead: Instead = lambda frame, why: False, ctrl_c: bool = False) -> Callable[[], None]:
    """Make SIGTERM and SIGHUP raise KeyboardInterrupt in the main thread, and print it as one line.

    Args:
        instead: called at the first signal. If it returns True, the session will end by itself, and only a signal more
            than a second later raises.
        ctrl_c: whether to handle SIGINT and print errors as one line, too. Set for LeRobot commands; the user's own
            programs keep their SIGINT handler (asyncio has one) and their tracebacks.

    Returns:
        Function that undoes this call. Idempotent.
    """
    global _users, _first_s, _waits, _report, _under_a_command
    _users += 1
    _under_a_command |= ctrl_c
    if ctrl_c and importlib.util.find_spec(_LOADED_AT_EXIT):
        importlib.import_module(_LOADED_AT_EXIT)
    _instead.append(instead)
    if _users == 1:
        _first_s, _waits = -math.inf, False
        if sys.excepthook is not _say_in_a_line:  # not restored: the hook must print after the last disconnect
            _report, sys.excepthook = sys.excepthook, _say_in_a_line
    if threading.current_thread() is threading.main_thread():
        for number, default in _DEFAULTS.items():
            if signal.getsignal(number) is default and (ctrl_c or number is not signal.SIGINT):
                _replaced[number] = signal.signal(number, _end_session)
    done = False

    def undo() -> None:
        nonlocal done
        global _users
        if done:
            return
        done = True
        _users -= 1
        _instead.remove(instead)
        if _users == 0 and threading.current_thread() is threading.main_thread():
            for number, handler in _replaced.items():
                if signal.getsignal(number) is _end_session:
                    signal.signal(number, handler)
            _replaced.clear()

    return undo


@contextmanager
def undisturbed(what: str) -> Iterator[None]:
    """Log SIGINT, SIGTERM and SIGHUP instead of obeying them while the block runs. Main thread only."""

    def answer(number: int, frame: FrameType | None) -> None:
        logger.warning("%s; the arms have no brakes, so this cannot be cut short", what)

    with _answered(answer):
        yield


@contextmanager
def finished_first(what: str) -> Iterator[None]:
    """Delay SIGINT, SIGTERM and SIGHUP until the block has run. No effect outside the main thread.

    Raises:
        KeyboardInterrupt: raised at the end of the block if a signal arrived.
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
    before = {number: signal.getsignal(number) for number in _DEFAULTS}
    try:
        for number in before:
            signal.signal(number, answer)
        yield
    finally:
        for number, handler in reversed(before.items()):  # SIGINT last, since its handler may interrupt this loop
            if handler is not None:  # None: a handler set by C code cannot be restored
                signal.signal(number, handler)
