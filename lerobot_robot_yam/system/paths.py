"""Paths as people write them."""

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
