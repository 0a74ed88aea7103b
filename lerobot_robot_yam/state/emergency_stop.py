"""Emergency stop for all arms of one user on this machine: any program may latch the stop, a person releases it.

The latch is a file, which outlives the process that created it; a loop checks for the file at each tick, in 4 µs. If no
file can be created because of a full disk or a lack of file descriptors, the sticky bit of the directory is the latch:
changing the directory's mode bits needs neither disk space nor a descriptor.
"""

import contextlib
import errno
import json
import logging
import os
import stat
import time
from collections.abc import Iterator
from pathlib import Path

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.runtime_files import runtime_dir

logger = logging.getLogger(__name__)

_FILE = "emergency-stop"
_MOST_BYTES = 65536  # maximum number of bytes read from the file
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.ENOMEM)  # error codes of a full disk
_NO_DESCRIPTOR = (errno.EMFILE, errno.ENFILE)  # error codes of a lack of file descriptors
_NO_ROOM = "unknown: there was no room to write it down"


class EmergencyStop:
    """Latch of the emergency stop. While latched, followers hold, leaders float, and no further arm can be energised.

    EmergencyStop().latch("somebody shouted")

    Args:
        directory: runtime directory of the user whose arms are stopped; None: this user's.

    Raises:
        ConfigError: no runtime directory can be created for this user.
    """

    def __init__(self, directory: Path | None = None) -> None:
        self._own = directory is None
        self.directory = runtime_dir() if directory is None else directory
        self._directory_name = str(self.directory)  # a string, since `Path` is slower in a loop
        self._name = str(self.directory / _FILE)
        self._unwritten = False  # whether latched in this object only, invisible to other processes
        self._seen_in: int | None = None  # inode of the directory with the latch; /dev/shm never reuses inodes

    @property
    def latched(self) -> bool:
        """Whether the emergency stop is latched."""
        if os.access(self._name, os.F_OK) or self._marked:
            if self._seen_in is None:
                self._seen_in, self._unwritten = self._directory_number(), False
            return True
        seen_in, self._seen_in = self._seen_in, None
        if seen_in is not None and seen_in != self._directory_number():
            with contextlib.suppress(OSError):  # on failure only this object stays latched
                self.latch(f"{self.directory} was removed with the stop in it, by a log-out perhaps")
            return True
        return self._unwritten

    @property
    def _marked(self) -> bool:
        """Whether the directory has the sticky bit."""
        try:
            return bool(os.lstat(self._directory_name).st_mode & stat.S_ISVTX)
        except OSError:
            return False

    def _directory_number(self) -> int:
        try:
            return os.stat(self.directory).st_ino
        except OSError:
            return 0

    def reason(self) -> str:
        """Return reason, process and time of the stop; empty if not latched."""
        try:
            with self._inside() as directory:
                file = os.open(_FILE, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK, dir_fd=directory)
            with open(file, "rb") as text:
                data = json.loads(text.read(_MOST_BYTES))
            return f"{data['why']} (process {data['pid']}, {data['at']})"
        except FileNotFoundError:
            return _NO_ROOM if self._marked else ""
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            return "unknown"

    def latch(self, why: str) -> None:
        """Latch the emergency stop, until `release`. If already latched, the first reason stays.

        Raises:
            OSError: the latch cannot be written, so that other processes do not stop; this object stays latched.
        """
        if self.latched:
            return
        self._unwritten = True
        if self._own:
            with contextlib.suppress(ConfigError):
                runtime_dir()  # recreates the directory if a log-out has removed it
        try:
            self._write(why)
        except OSError as error:
            if not self._own or error.errno not in _NO_DESCRIPTOR:
                raise
            os.chmod(self.directory, stat.S_IMODE(os.stat(self.directory).st_mode) | stat.S_ISVTX)
        self._unwritten = False
        logger.error("emergency stop: %s; release it with `yam-estop release`", why)

    def _write(self, why: str) -> None:
        with self._inside() as directory:
            try:
                file = os.open(_FILE, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600, dir_fd=directory)
            except FileExistsError:
                if not os.path.exists(self._name):  # a broken link; else another process was faster
                    raise
            except OSError as error:
                if error.errno not in _FULL:
                    raise
                os.fchmod(directory, stat.S_IMODE(os.fstat(directory).st_mode) | stat.S_ISVTX)
            else:  # the file itself is the latch, even if the disk is too full for its text
                data = {"why": why, "pid": os.getpid(), "at": time.strftime("%Y-%m-%d %H:%M:%S")}
                with contextlib.suppress(OSError), open(file, "w") as text:
                    os.fchmod(file, 0o644)  # root may stop other users, who must be able to read the reason
                    text.write(json.dumps(data) + "\n")

    def release(self) -> None:
        """Release the stop; arms resume from their present pose. Raises OSError: the latch cannot be removed."""
        with contextlib.suppress(FileNotFoundError), self._inside() as directory:
            mode = stat.S_IMODE(os.fstat(directory).st_mode)
            if mode & stat.S_ISVTX:
                os.fchmod(directory, mode & ~stat.S_ISVTX)
            os.unlink(_FILE, dir_fd=directory)

    @contextlib.contextmanager
    def _inside(self) -> Iterator[int]:
        """Open the directory without following symbolic links, since root may latch in other users' directories."""
        directory = os.open(self.directory, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        try:
            yield directory
        finally:
            os.close(directory)
