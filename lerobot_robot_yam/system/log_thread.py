"""Logging that cannot block a loop: a stopped terminal (Ctrl-S) or a full pipe blocks only the logging thread."""

import logging
import queue
from collections.abc import Iterator
from contextlib import contextmanager
from logging.handlers import QueueHandler, QueueListener

_LAST_LINES_S = 1.0  # maximum wait for the last log lines to be written, s


@contextmanager
def log_from_a_thread() -> Iterator[None]:
    """Run the root logger's handlers in another thread while the block runs."""
    root = logging.getLogger()
    handlers = root.handlers[:]
    lines: queue.SimpleQueue = queue.SimpleQueue()
    listener = QueueListener(lines, *handlers)
    root.handlers[:] = [QueueHandler(lines)]
    listener.start()  # daemon thread: if it is blocked, the process exits without the last lines
    thread = listener._thread
    try:
        yield
    finally:
        root.handlers[:] = handlers
        listener.enqueue_sentinel()
        if thread is not None:
            thread.join(_LAST_LINES_S)
