"""Where locks, state blocks and rig sockets of this user live, and who holds what.

Every file name carries the CAN channel and, on a virtual rig, the rig's id, so two rigs never meet.
"""

import fcntl
import os
import re
import stat
import tempfile
from pathlib import Path
from types import TracebackType

from lerobot_robot_yam.errors import ChannelInUseError, ConfigError

ENV_RUNTIME_DIR = "YAM_RUNTIME_DIR"
ENV_RIG = "YAM_RIG"
AUTO_RIG = "auto-"
_RIG_NAME_MAX = 64  # it is part of a socket's path, which may have 108 bytes in all


def runtime_dir() -> Path:
    """Directory for sockets, locks and shared blocks; created with mode 0700.

    `YAM_RUNTIME_DIR`, else a tmpfs of this user, else the temporary directory. Unix sockets live here,
    so the path must stay short (108 bytes in all).

    Raises:
        ConfigError: the directory cannot be made, or belongs to somebody else.
    """
    explicit = os.environ.get(ENV_RUNTIME_DIR)
    if explicit:
        path = Path(explicit)
    else:
        shared_memory = "/dev/shm" if os.access("/dev/shm", os.W_OK) else tempfile.gettempdir()
        base = os.environ.get("XDG_RUNTIME_DIR") or shared_memory
        path = Path(base) / f"yam-{os.getuid()}"
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        info = path.stat()
    except OSError as error:
        raise ConfigError(f"{path} cannot be used for sockets and locks ({error}); set {ENV_RUNTIME_DIR}") from error
    if info.st_uid != os.getuid() or not stat.S_ISDIR(info.st_mode):
        raise ConfigError(f"{path} is not a directory of this user; set {ENV_RUNTIME_DIR} to one that is")
    return path


def slug(name: str) -> str:
    """File-name form of a channel or rig name."""
    return re.sub(r"[^A-Za-z0-9_.-]", "-", name)


def rig_name(rig: str | None = None) -> tuple[str, int | None]:
    """Resolve a virtual rig's name: the argument, else the variable YAM_RIG, else "auto".

    "auto" is the rig of this process, "auto:1234" that of process 1234.

    Returns:
        The name and, for auto rigs, the pid of the owner.

    Raises:
        ConfigError: "auto:" is not followed by a process id, or the name cannot be part of a file's name.
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
    """Exclusive advisory lock on a file, released by the kernel when its holder dies.

    The holder's pid is written into the file so that a refusal can name it.
    """

    def __init__(self, path: Path, what: str):
        self._path = path
        self._what = what
        self._fd: int | None = None

    def acquire(self, blocking: bool = False) -> None:
        """Take the lock.

        Raises:
            ChannelInUseError: somebody else holds it (only when not blocking).
        """
        while True:
            fd = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            try:
                fcntl.flock(fd, fcntl.LOCK_EX | (0 if blocking else fcntl.LOCK_NB))
            except BlockingIOError:
                holder = os.pread(fd, 32, 0).decode(errors="replace").strip() or "unknown"
                os.close(fd)
                raise ChannelInUseError(
                    f"{self._what} is in use by process {holder}; end that process (ps -p {holder}) and try again"
                ) from None
            # The previous holder may have unlinked the file between our open and our lock.
            try:
                same = os.stat(self._path).st_ino == os.fstat(fd).st_ino
            except FileNotFoundError:
                same = False
            if same:
                break
            os.close(fd)
        os.ftruncate(fd, 0)
        os.pwrite(fd, f"{os.getpid()}\n".encode(), 0)
        self._fd = fd

    @property
    def held(self) -> bool:
        """Whether it is ours."""
        return self._fd is not None

    def release(self) -> None:
        """Remove the file and let go; does nothing when not held."""
        if self._fd is not None:
            self._path.unlink(missing_ok=True)
            os.close(self._fd)
            self._fd = None

    def __enter__(self) -> "FileLock":
        self.acquire(blocking=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()
