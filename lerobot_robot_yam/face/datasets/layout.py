"""Where a LeRobot data set (format v3) is, and what its files say, for those who read them without LeRobot.

LeRobot takes seconds to import: nothing here needs it, but to find a data set by its name.
"""

import json
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.paths import user_path

Progress = Callable[[Iterable[Any]], Iterable[Any]]
"""Wraps a loop to show how far it is."""

INFO = Path("meta", "info.json")
DEGREES_SUFFIX = "_degrees"  # of the name of a robot whose joints are recorded in degrees


def locate(path_or_repo_id: str) -> Path:
    """The directory of a data set, given itself or as the name that LeRobot stores it under, here or on the Hub.

    One that is not on this computer is downloaded by LeRobot.

    Raises:
        ConfigError: there is no such data set, or it cannot be downloaded.
    """
    path = user_path(path_or_repo_id)
    if path.is_dir():
        return path
    from lerobot.utils.constants import HF_LEROBOT_HOME

    stored = HF_LEROBOT_HOME / path_or_repo_id
    if (stored / "meta").is_dir():
        return stored
    from lerobot.datasets import LeRobotDataset  # seconds to import

    try:
        return Path(LeRobotDataset(path_or_repo_id).root)
    except Exception as error:  # no such name, no network: LeRobot and the Hub raise anything
        raise ConfigError(
            f"{path_or_repo_id} is no directory, no data set in {HF_LEROBOT_HOME}, and cannot be had from the Hub: "
            f"{type(error).__name__}: {str(error).partition(chr(10))[0][:200]}"
        ) from error


def clip_columns(key: str) -> list[str]:
    """Names of an episode's metadata about its clip of a camera: chunk, file, begin and end (s) in the file."""
    return [f"videos/{key}/{name}" for name in ("chunk_index", "file_index", "from_timestamp", "to_timestamp")]


def is_depth(feature: Mapping[str, Any]) -> bool:
    """Whether a camera gives distances, not colours."""
    return bool((feature.get("info") or {}).get("is_depth_map"))


def value_names(feature: Mapping[str, Any]) -> tuple[str, ...]:
    """Names of the values of a feature; empty where it has none."""
    names = feature.get("names")
    if isinstance(names, Mapping):  # of older data sets {"motors": […]}; of LeRobot's RL stack {"delta_x": 0, …}
        groups = [value for value in names.values() if isinstance(value, list)]
        names = [name for group in groups for name in group] if groups else sorted(names, key=names.__getitem__)
    return tuple(names or ())


def frame_count(path: Path) -> int:
    """Frames that a video file says it has; 0 where it cannot be opened."""
    import av

    try:
        with closing(av.open(str(path))) as video:
            return sum(stream.frames for stream in video.streams.video[:1])
    except (av.FFmpegError, OSError):
        return 0


def episodes_in(root: Path) -> int | None:
    """How many episodes the data set in a folder has; None if there is no data set."""
    try:
        return int(json.loads((root / INFO).read_text())["total_episodes"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def is_empty(root: Path) -> bool:
    """Whether a folder is a data set in which nothing was ever recorded: no rows, no images, no videos."""
    recorded = (path for pattern in ("*.parquet", "*.mp4", "*.png") for path in root.rglob(pattern))
    return episodes_in(root) == 0 and next(recorded, None) is None
