"""Runtime directories of the users of this computer, and the processes that hold locks in them.

Paths are strings, and this module imports next to nothing, because `yam-estop` must not wait for imports.
"""

import fcntl
import os
import stat

from lerobot_robot_yam.errors import ConfigError

ENV_RUNTIME_DIR = "YAM_RUNTIME_DIR"
# prefixes of the file names of a driver's lock and of a state block, followed by a channel's key
LOCK, STATE = "lock-", "state-"
_SHARED = ("/dev/shm", "/tmp")  # parents; the same in every shell, unlike XDG_RUNTIME_DIR and TMPDIR
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH


def make_runtime_dir() -> str:
    """Return this user's runtime directory; create it with mode 0700. See `runtime_files.runtime_dir`.

    Raises:
        ConfigError: the directory cannot be created, belongs to another user, or is writable by others.
    """
    path = _own_path()
    try:
        os.makedirs(path, mode=0o700, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{path} cannot be used for sockets and locks ({error}); set {ENV_RUNTIME_DIR}") from error
    if not _is_directory_of(path, os.getuid()):
        raise ConfigError(f"{path} is not a directory of this user; set {ENV_RUNTIME_DIR} to one that is")
    mode = stat.S_IMODE(os.stat(path).st_mode)
    if mode & _OTHERS_WRITE:
        raise ConfigError(
            f"{path} is open to others (mode {mode:o}), who could stop or release your arms; close it with "
            f"`chmod go-w {path}`, or set {ENV_RUNTIME_DIR} to a directory of yours alone"
        )
    return path


def runtime_dirs() -> list[str]:
    """List the runtime directories of all users on this machine; this user's is first, even if it does not exist.

    If `YAM_RUNTIME_DIR` is set, only that directory is listed. Every user can write to /dev/shm, so other users'
    directories count only if they are not links and belong to the user whose id is in the name.
    """
    own = _own_path()
    if os.environ.get(ENV_RUNTIME_DIR):
        return [own]
    found = [own]
    for base in _SHARED:
        numbers = [name[4:] for name in sorted(_names(base)) if name.startswith("yam-") and name[4:].isdecimal()]
        paths = {f"{base}/yam-{number}": int(number) for number in numbers}
        found += [path for path, uid in paths.items() if path != own and _is_directory_of(path, uid)]
    return found


def _own_path() -> str:
    explicit = os.environ.get(ENV_RUNTIME_DIR)
    if explicit:
        return explicit
    base = next((base for base in _SHARED if os.access(base, os.W_OK)), _SHARED[-1])
    return f"{base}/yam-{os.getuid()}"


def _is_directory_of(path: str, uid: int) -> bool:
    try:
        info = os.lstat(path)
    except OSError:
        return False
    return stat.S_ISDIR(info.st_mode) and info.st_uid == uid


def _names(directory: str | os.PathLike[str]) -> list[str]:
    try:
        return os.listdir(directory)
    except OSError:
        return []


def sessions(directory: str | os.PathLike[str]) -> dict[str, str]:
    """Map channel keys to the processes that drive arms, which hold the channel's lock and publish a state.

    Programs that set up motors hold only the lock.
    """
    holders = lock_holders(directory).items()
    # lexists, since a state file may be a link that a container cannot follow
    return {key: holder for key, holder in holders if os.path.lexists(os.path.join(directory, f"{STATE}{key}"))}


def lock_holders(directory: str | os.PathLike[str]) -> dict[str, str]:
    """Map channel keys to the processes that hold the channels' locks: sessions, and programs that set up motors."""
    locks = [name for name in sorted(_names(directory)) if name.startswith(LOCK)]
    holders = {name.removeprefix(LOCK): _lock_holder(os.path.join(directory, name)) for name in locks}
    return {key: holder for key, holder in holders.items() if holder is not None}


def _lock_holder(path: str) -> str | None:
    """Read the process id of a lock's holder; None if the lock is free."""
    try:
        fd = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        fcntl.flock(fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return written_pid(fd)
    finally:
        os.close(fd)
    return None


def written_pid(fd: int) -> str:
    """Read the process id in a lock file."""
    try:
        return str(int(os.pread(fd, 32, 0)))
    except (OSError, ValueError):
        return "unknown"
