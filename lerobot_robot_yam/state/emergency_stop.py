"""Emergency stop for all arms of one user on this machine: any program may latch the stop, a person releases it.

The latch outlives the process that created it (see `stop_latch`); a loop checks it at each tick, in 4 µs.
"""

import contextlib
import logging
import os

from lerobot_robot_yam.state.stop_latch import OWN, StopLatch, source_name

logger = logging.getLogger(__name__)

_LOG_OUT = "log-out"  # source of a stop that a log-out has removed


class EmergencyStop(StopLatch):
    """Emergency stop of a running program. While latched, followers hold, leaders float, and no further arm can be
    energised.

    EmergencyStop().latch("somebody shouted")

    Arguments and errors are those of `StopLatch`.
    """

    def __init__(self, directory: str | os.PathLike[str] | None = None) -> None:
        super().__init__(directory)
        self._unwritten = False  # whether latched in this object only, invisible to other processes
        self._unnamed: set[str] = set()  # sources latched by this object without a file, while there is no room
        self._seen_in: int | None = None  # inode of the directory with the latch; /dev/shm never reuses inodes

    @property
    def latched(self) -> bool:
        """Whether the emergency stop is latched."""
        if super().latched:
            if self._seen_in is None:
                self._seen_in, self._unwritten = self._directory_number(), False
            return True
        seen_in, self._seen_in = self._seen_in, None
        if seen_in is not None and seen_in != self._directory_number():
            with contextlib.suppress(OSError):  # on failure only this object stays latched
                self.latch(f"{self.directory} was removed with the stop in it, by a log-out perhaps", _LOG_OUT)
            return True
        return self._unwritten

    def _directory_number(self) -> int:
        try:
            return os.stat(self.directory).st_ino
        except OSError:
            return 0

    def latch(self, why: str, source: str = OWN) -> None:
        """Latch the emergency stop for a source, until its `release`. The source's first reason stays.

        Raises:
            OSError: the latch cannot be written, so that other processes do not stop; this object stays latched.
        """
        source = source_name(source)
        if os.access(f"{self._name}/{source}", os.F_OK) or (source in self._unnamed and self._marked):
            return
        if self._unwritten and not super().latched:
            return  # a loop latches at each tick
        self._unwritten = True
        super().latch(why, source)
        self._unwritten = False
        self._unnamed = self._unnamed | {source} if self._marked else set()
        logger.error("emergency stop: %s; release it with `yam-estop release %s`", why, source)
