"""Location and files of a LeRobot data set (format v3), for code that reads data sets without LeRobot.

Importing LeRobot takes seconds, so this module imports it only to find a data set by its name.
"""

import json
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.paths import user_path

Progress = Callable[[Iterable[Any]], Iterable[Any]]
"""Wrapper that iterates over a loop and shows its progress."""

INFO = Path("meta", "info.json")
DEGREES_SUFFIX = "_degrees"  # suffix of a robot's name if its joints are recorded in degrees


def locate(path_or_repo_id: str) -> Path:
    """Return the directory of a data set, given by path or by LeRobot's name, on this computer or on the Hub.

    LeRobot downloads a data set that is not on this computer.

    Raises:
        ConfigError: the data set does not exist, or cannot be downloaded.
    """
    path = user_path(path_or_repo_id)
    if path.is_dir():
        return path
    from lerobot.utils.constants import HF_LEROBOT_HOME

    stored = HF_LEROBOT_HOME / path_or_repo_id
    if (stored / "meta").is_dir():
        return stored
    from lerobot.datasets import LeRobotDataset  # takes seconds to import

    try:
        return Path(LeRobotDataset(path_or_repo_id).root)
    except Exception as error:  # no such name, no network: LeRobot and the Hub can raise any exception
        raise ConfigError(
            f"{path_or_repo_id} is no directory, no data set in {HF_LEROBOT_HOME}, and cannot be had from the Hub: "
            f"{type(error).__name__}: {str(error).partition(chr(10))[0][:200]}"
        ) from error


def clip_columns(key: str) -> list[str]:
    """Return the metadata columns of an episode for a camera's clip: chunk, file, start and end (s) in the file."""
    return [f"videos/{key}/{name}" for name in ("chunk_index", "file_index", "from_timestamp", "to_timestamp")]


def is_depth(feature: Mapping[str, Any]) -> bool:
    """Return whether a camera records depth instead of colours."""
    return bool((feature.get("info") or {}).get("is_depth_map"))


def value_names(feature: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names of a feature's values; empty without names."""
    names = feature.get("names")
    if isinstance(names, Mapping):  # {"motors": […]} in older data sets, {"delta_x": 0, …} in LeRobot's RL stack
        groups = [value for value in names.values() if isinstance(value, list)]
        names = [name for group in groups for name in group] if groups else sorted(names, key=names.__getitem__)
    return tuple(names or ())


def frame_count(path: Path) -> int:
    """Return the number of frames according to a video file's header; 0 if the file cannot be opened."""
    import av

    try:
        with closing(av.open(str(path))) as video:
            return sum(stream.frames for stream in video.streams.video[:1])
    except (av.FFmpegError, OSError):
        return 0


def episodes_in(root: Path) -> int | None:
    """Return the number of episodes of the data set in a folder; None without a data set."""
    try:
        return int(json.loads((root / INFO).read_text())["total_episodes"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def is_empty(root: Path) -> bool:
    """Return whether a folder is a data set without any recorded content: no rows, images or videos."""
    recorded = (path for pattern in ("*.parquet", "*.mp4", "*.png") for path in root.rglob(pattern))
    return episodes_in(root) == 0 and next(recorded, None) is None
