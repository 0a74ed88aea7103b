"""Configuration of a running arm, in a file next to its state block, for programs that monitor arms."""

import contextlib
import dataclasses
import json
import logging
import os
from pathlib import Path
from typing import Any

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.system.runtime_files import ABOUT, runtime_dir

logger = logging.getLogger(__name__)

_MOST_BYTES = 1 << 20  # maximum number of bytes read from a file


def about_path(key: str) -> Path:
    """Return the path of the configuration file for the arm with the channel key `key`."""
    return runtime_dir() / f"{ABOUT}{key}"


def tell_about(key: str, config: ArmConfig | BaseConfig) -> None:
    """Write an arm's configuration file; log a warning if writing fails."""
    try:
        path = about_path(key)
        aside = path.with_name(f".{path.name}.{os.getpid()}")
        aside.write_text(json.dumps(dataclasses.asdict(config)))
        aside.replace(path)
    except (OSError, YamError) as error:
        logger.warning("%s: no other program can know what arm this is: %s", config.name, error)


def forget_about(key: str) -> None:
    """Remove an arm's configuration file. Idempotent."""
    with contextlib.suppress(OSError, YamError):
        about_path(key).unlink()


def read_about(directory: Path, key: str) -> dict[str, Any] | None:
    """Read the fields of an arm's configuration from a runtime directory; return None if absent or invalid."""
    try:
        with open(directory / f"{ABOUT}{key}", "rb") as file:
            found = json.loads(file.read(_MOST_BYTES))
    except (OSError, ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None
