"""Paths with `~`, and atomic writing of files."""

import contextlib
import os
import stat
from pathlib import Path

from lerobot_robot_yam.errors import ConfigError


def user_path(path: str | Path) -> Path:
    """Expand a leading `~`, which shells leave in files and after `=`. Raises ConfigError: there is no such user."""
    try:
        return Path(path).expanduser()
    except RuntimeError as error:
        raise ConfigError(f"{path}: {error}; write the path in full") from error


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file atomically, creating missing directories; after a crash the old file is intact.

    An existing file keeps its mode and, if this process has the permission, its owner.

    Raises:
        OSError: the file cannot be written.
    """
    scratch = path.with_name(f"{path.name}.{os.getpid()}")  # unique per process: two processes may write at once
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        old = path.stat() if path.exists() else None
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC
        with os.fdopen(os.open(scratch, flags, 0o600 if old else 0o666), "wb") as file:
            if old is not None:
                with contextlib.suppress(PermissionError):
                    os.fchown(file.fileno(), old.st_uid, old.st_gid)
                os.fchmod(file.fileno(), stat.S_IMODE(old.st_mode))
            file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        scratch.replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            scratch.unlink(missing_ok=True)
        raise
