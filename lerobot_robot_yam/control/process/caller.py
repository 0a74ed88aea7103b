"""Connection to the caller, the process that started this one to drive arms: read the job, reply, detect its end.

A JSON line on standard input names the arms; a JSON line on standard output reports "ready" or an error. This process
runs in its own session, out of reach of Ctrl-C, and continues when the terminal is closed.
"""

import contextlib
import json
import logging
import os
import signal
import sys
import threading
from collections.abc import Iterator
from typing import Any

from lerobot_robot_yam.control.process.lifeline import ProcessEnd, hung_up
from lerobot_robot_yam.errors import YamError

logger = logging.getLogger(__name__)

_STACK_BYTES = 1 << 20  # stack of a thread, bytes: all of it is locked in memory, and the usual 8 MB are never used


class Caller:
    """Caller of this process. Create this object first, in the main thread: the constructor waits for the job.

    Attributes:
        job: the caller's request.

    Raises:
        SystemExit: the caller has already exited.
    """

    def __init__(self) -> None:
        logging.basicConfig(
            level=logging.INFO,
            format="%(levelname)s %(asctime)s %(name)s %(message)s",
            datefmt="%Y-%m-%d %H:%M:%S",
        )
        logging.raiseExceptions = False  # the terminal may be closed while the arms still have to land
        for name in (signal.SIGINT, signal.SIGHUP, signal.SIGPIPE):
            signal.signal(name, signal.SIG_IGN)
        self._ended = self._gone = False
        threading.stack_size(_STACK_BYTES)
        signal.signal(signal.SIGTERM, self._end)
        self.job: dict[str, Any] = json.loads(sys.stdin.readline())
        self._pid = int(self.job["parent_pid"])
        try:
            self._exit = ProcessEnd(self._pid)
        except FileNotFoundError:
            raise SystemExit(1) from None  # nothing has been energised

    def _end(self, *_: object) -> None:
        self._ended = True

    def watch(self, every_s: float) -> None:
        """Start a thread that checks whether the caller still runs. Fork earlier: threads do not survive a fork.

        Args:
            every_s: period of checking whether the caller has begun to exit, s; a finished exit is noticed at once.
        """
        threading.Thread(target=self._watch, args=[every_s], name="yam-parent", daemon=True).start()

    def _watch(self, every_s: float) -> None:
        """Check in a thread, since reading the status of a dying process may free its memory, which can be slow."""
        while not (hung_up(self.job["lifeline"], every_s) or self._exit.reached()):
            pass
        self._gone = True

    def wants_an_end(self) -> bool:
        """Return whether arms must land: the caller has sent SIGTERM, has exited, or executes another program."""
        if not self._ended and (self._gone or os.getppid() != self._pid):
            gone = "the process that started this one (%d) is gone, or runs another program: landing"
            logger.warning(gone, self._pid)
            self._ended = True
        return self._ended

    def answer(self, **fields: object) -> None:
        """Write one line to the caller, ignoring errors: `wants_an_end` detects a dead caller."""
        with contextlib.suppress(OSError):
            sys.stdout.write(json.dumps(fields) + "\n")
            sys.stdout.flush()

    @contextlib.contextmanager
    def hears_of_errors(self, of: str) -> Iterator[None]:
        """Report an exception inside the block to the caller, then exit with status 1. of: this process's name."""
        try:
            yield
            return
        except YamError as error:
            self.answer(error=str(error), kind=type(error).__name__)
        except Exception as error:
            logger.exception("%s failed", of)
            self.answer(error=f"{of} failed: {error!r}", kind="YamError")
        raise SystemExit(1)
