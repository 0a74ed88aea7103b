"""Runtime files of a user: locks, state blocks, rig sockets.

Every file name contains the CAN channel and, on a virtual rig, the rig's id, so that rigs never conflict.
"""

import contextlib
import fcntl
import os
import re
from pathlib import Path

from lerobot_robot_yam.errors import BusError, ChannelInUseError, ConfigError
from lerobot_robot_yam.system.runtime_dirs import make_runtime_dir, written_pid

ENV_RIG = "YAM_RIG"
AUTO_RIG = "auto-"
ABOUT = "about-"  # prefix of the file names of arms' configurations, followed by a channel's key
DESK = "desk-"  # prefix of the file names of a LeRobot command, followed by its process id
_CONTROL_PROCESS = "lerobot_robot_yam.control.process.control_process"
_RIG_NAME_MAX = 64  # maximum length of a rig's name, characters: socket paths contain it (limit 108 bytes)


def runtime_dir() -> Path:
    """Return the directory for sockets, locks, shared blocks and the emergency stop; create it with mode 0700.

    The path is `YAM_RUNTIME_DIR`, else a directory of this user in /dev/shm, else in /tmp. Variables of a login session
    are unsuitable: processes of cron, su, ssh and `docker exec` lack them, but must find the arms to stop. The path
    must be short, since it is part of socket paths (limit 108 bytes).

    Raises:
        ConfigError: the directory cannot be created, belongs to another user, or is writable by others.
    """
    return Path(make_runtime_dir())


def slug(name: str) -> str:
    """Replace the characters of a channel or rig name that are unsuitable in a file name."""
    return re.sub(r"[^A-Za-z0-9_.-]", "-", name)


def rig_name(rig: str | None = None) -> tuple[str, int | None]:
    """Resolve a virtual rig's name: the argument, else the variable YAM_RIG, else "auto".

    "auto" is the rig of this process, "auto:1234" that of process 1234.

    Returns:
        The name and, for auto rigs, the process id of the owner.

    Raises:
        ConfigError: "auto:" is not followed by a process id, or the name cannot be part of a file name.
    """
    if rig is not None and (not isinstance(rig, str) or len(rig) > _RIG_NAME_MAX or "\0" in rig):
        raise ConfigError(f"a rig's name is a text of at most {_RIG_NAME_MAX} characters, not {rig!r}")
    rig = rig or os.environ.get(ENV_RIG) or "auto"
    if rig == "auto":
        return f"{AUTO_RIG}{os.getpid()}", os.getpid()
    for prefix in ("auto:", AUTO_RIG):
        if rig.startswith(prefix):
            if not re.fullmatch("[0-9]+", rig[len(prefix) :]):
                raise ConfigError(f"rig {rig!r}: after 'auto:' comes a process id")
            owner = int(rig[len(prefix) :])
            return f"{AUTO_RIG}{owner}", owner
    return rig, None


class FileLock:
    """Exclusive advisory lock on a file; the kernel releases it when the holder dies.

    The file contains the holder's process id, so that error messages can name the holder.
    """

    def __init__(self, path: Path, what: str):
        self._path = path
        self._what = what
        self._fd: int | None = None

    def acquire(self, blocking: bool = False) -> None:
        """Acquire the lock.

        Raises:
            ChannelInUseError: another process holds the lock (only if not blocking).
            BusError: the lock file cannot be created.
        """
        while True:
            try:
                fd = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            except OSError as error:
                raise BusError(
                    f"{self._what} cannot be locked: {self._path}: {error.strerror}; is {self._path.parent} full?"
                ) from error
            try:
                fcntl.flock(fd, fcntl.LOCK_EX | (0 if blocking else fcntl.LOCK_NB))
            except BlockingIOError:
                holder = written_pid(fd)
                os.close(fd)
                raise ChannelInUseError(
                    f"{self._what} is in use by process {holder}{_program_of(holder)}; wait while it lands its arms, "
                    "else end it, and try again"
                ) from None
            # The previous holder may have removed the file between open and flock.
            if self._is_ours(fd):
                break
            os.close(fd)
        self._fd = fd
        with contextlib.suppress(OSError):  # the lock works even on a full disk
            os.ftruncate(fd, 0)
            os.pwrite(fd, f"{os.getpid()}\n".encode(), 0)

    def _is_ours(self, fd: int) -> bool:
        """Return whether the path still refers to the file that this object has open."""
        try:
            return os.stat(self._path).st_ino == os.fstat(fd).st_ino
        except FileNotFoundError:
            return False

    @property
    def held(self) -> bool:
        """Whether this object holds the lock."""
        return self._fd is not None

    def release(self) -> None:
        """Remove the file, unless it was replaced, and release the lock. Idempotent."""
        if self._fd is not None:
            with contextlib.suppress(OSError):
                if self._is_ours(self._fd):
                    self._path.unlink()
            os.close(self._fd)
            self._fd = None

    def __enter__(self) -> "FileLock":
        self.acquire(blocking=True)
        return self

    def __exit__(self, *_: object) -> None:
        self.release()


def _program_of(holder: str) -> str:
    """Name the program that holds a lock; for a control process also the program for which it drives the arm."""
    words = _words(holder)
    if _CONTROL_PROCESS in words:
        with contextlib.suppress(OSError, IndexError):
            fields = Path(f"/proc/{holder}/stat").read_text().rpartition(")")[2].split()
            caller = fields[1]
            return f", which drives it for {_program(_words(caller))}, process {caller} (ps -p {caller})"
    return f", {_program(words)} (ps -p {holder})" if words else f" (ps -p {holder})"


def _words(pid: str) -> list[str]:
    try:
        return Path(f"/proc/{pid}/cmdline").read_text(errors="replace").split("\0")[:-1]
    except OSError:
        return []


def _program(words: list[str]) -> str:
    """Name a program by its command line; a Python program by its script instead of the interpreter."""
    names = [os.path.basename(word) for word in words if not word.startswith("-")]
    if len(names) > 1 and names[0].startswith("python") and "-c" not in words:
        return names[1]
    return names[0] if names else "a program that has ended"
