"""Paths as people write them, and files that are whole or as they were."""

import contextlib
import os
from pathlib import Path

from lerobot_robot_yam.errors import ConfigError


def user_path(path: str | Path) -> Path:
    """The path with a leading `~` expanded, which no shell does in a file or after `=`.

    Raises:
        ConfigError: there is no such user.
    """
    try:
        return Path(path).expanduser()
    except RuntimeError as error:
        raise ConfigError(f"{path}: {error}; write the path in full") from error


def write_whole(path: Path, text: str) -> None:
    """Write a file, and the directories that it needs, so that a crash in the middle leaves the old one.

    Raises:
        OSError: it cannot be written.
    """
    scratch = path.with_name(f"{path.name}.{os.getpid()}")  # two processes may write at once
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with scratch.open("w") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        scratch.replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            scratch.unlink(missing_ok=True)
        raise
