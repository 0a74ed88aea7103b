"""What the files of a LeRobot data set (format v3) say, for those who read them without LeRobot.

LeRobot takes seconds to import; nothing here needs it.
"""

from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

Progress = Callable[[Iterable[Any]], Iterable[Any]]
"""Wraps a loop to show how far it is."""

DEGREES_SUFFIX = "_degrees"  # of the name of a robot whose joints are recorded in degrees


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
