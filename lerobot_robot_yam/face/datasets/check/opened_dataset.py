"""Data set opened for the check: the rows of each episode as arrays, and flags for unreadable files.

Neither pictures nor LeRobot are loaded: 200 episodes of 1,000 frames open in well under a second.
"""

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.datasets.check.flags import Flag, Kind
from lerobot_robot_yam.face.datasets.layout import DEGREES_SUFFIX, clip_columns
from lerobot_robot_yam.face.recorder.kept_episodes import read_figures

ACTION, STATE = "action", "observation.state"
_ALWAYS = ("episode_index", "frame_index", "index", "task_index", "timestamp")
_FORMAT = "v3."


@dataclass(frozen=True)
class RecordedEpisode:
    """Episode of an opened data set.

    Attributes:
        number: `episode_index` of the episode.
        metadata: LeRobot's row about the episode, empty without one. Statistics are nested: {"stats": {"action": {…}}}.
        rows: name of a column → (n,) or (n, values) array, for the columns that the data set has.
        figures: the episode's row in this package's side-car file, empty without a row.
    """

    number: int
    metadata: Mapping[str, Any]
    rows: Mapping[str, np.ndarray]
    figures: Mapping[str, Any]

    @property
    def length(self) -> int:
        return len(self.rows.get("frame_index", ()))


@dataclass
class OpenedDataset:
    """Data set whose rows and metadata are loaded.

    Attributes:
        root: directory of the data set.
        info: content of `meta/info.json`.
        tasks: `task_index` → text of the task.
        statistics: content of `meta/stats.json`, empty if the file cannot be read.
        episodes: the episodes, sorted by number.
        flags: flags for defects of the files.
    """

    root: Path
    info: dict[str, Any]
    tasks: dict[int, str] = field(default_factory=dict)
    statistics: dict[str, Any] = field(default_factory=dict)
    episodes: list[RecordedEpisode] = field(default_factory=list)
    flags: list[Flag] = field(default_factory=list)

    @property
    def fps(self) -> float:
        """Frames per second according to `meta/info.json`."""
        return float(self.info["fps"])

    @property
    def features(self) -> dict[str, Any]:
        return self.info["features"]

    @property
    def unit(self) -> float:
        """Radians per recorded unit of a joint."""
        degrees = str(self.info.get("robot_type") or "").endswith(DEGREES_SUFFIX)
        return math.radians(1.0) if degrees else 1.0

    @property
    def cameras(self) -> list[str]:
        """Names of the video features."""
        return [key for key, feature in self.features.items() if feature["dtype"] == "video"]

    def clip(self, episode: RecordedEpisode, camera: str) -> tuple[Path, float] | None:
        """Return (an episode's video file, start of the episode in that file, s); None without such metadata."""
        chunk, file, start_s = (episode.metadata.get(name) for name in clip_columns(camera)[:3])
        if chunk is None or file is None or start_s is None:
            return None
        name = self.info["video_path"].format(video_key=camera, chunk_index=chunk, file_index=file)
        return self.root / name, float(start_s)


def open_dataset(root: Path) -> OpenedDataset:
    """Read a data set, except its pictures.

    Raises:
        ConfigError: the directory is not a data set of format v3, or its description cannot be read.
    """
    try:
        info = json.loads((root / "meta" / "info.json").read_text())
        version, _, _ = info["codebase_version"], info["fps"], info["features"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{root / 'meta' / 'info.json'} cannot be read: {error}; try yam-repair-dataset") from error
    if not str(version).startswith(_FORMAT):
        raise ConfigError(f"{root} has the format {version}; convert it with LeRobot's convert_dataset_v21_to_v30")
    data = OpenedDataset(root, info)
    data.tasks, data.statistics = _tasks(data), _statistics(data)
    metadata = _metadata(data)
    rows, figures = dict(_rows(data)), read_figures(root)
    for number in sorted({*metadata, *rows}):
        parts = metadata.get(number, {}), rows.get(number, {}), figures.get(number, {})
        data.episodes.append(RecordedEpisode(number, *parts))
    return data


def _unreadable(data: OpenedDataset, path: Path, error: Exception) -> None:
    why = str(error).partition("\n")[0][:100]
    data.flags.append(Flag(Kind.UNREADABLE, f"{path.relative_to(data.root)}: {why}"))


def _tasks(data: OpenedDataset) -> dict[int, str]:
    path = data.root / "meta" / "tasks.parquet"
    try:
        table = pq.ParquetFile(path).read().to_pydict()  # not read_table, which imports pandas first
        (text,) = [name for name in table if name != "task_index"]  # LeRobot's index column, whatever its name is
        return dict(zip(table["task_index"], table[text], strict=True))
    except (pa.ArrowException, OSError, ValueError, KeyError) as error:
        _unreadable(data, path, error)
        return {}


def _statistics(data: OpenedDataset) -> dict[str, Any]:
    path = data.root / "meta" / "stats.json"
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError) as error:
        _unreadable(data, path, error)
        return {}


def _metadata(data: OpenedDataset) -> dict[int, dict[str, Any]]:
    found: dict[int, dict[str, Any]] = {}
    for path in sorted((data.root / "meta" / "episodes").rglob("*.parquet")):
        try:
            names = [name for name in pq.read_schema(path).names if not name.startswith("stats/") or _is_wanted(name)]
            for row in pq.ParquetFile(path).read(columns=names).to_pylist():
                stats: dict[str, dict[str, Any]] = {}
                for name in [name for name in row if name.startswith("stats/")]:
                    _, feature, statistic = name.split("/")
                    stats.setdefault(feature, {})[statistic] = row.pop(name)
                found[row["episode_index"]] = row | {"stats": stats}
        except (pa.ArrowException, OSError, KeyError) as error:
            _unreadable(data, path, error)
    return found


def _is_wanted(name: str) -> bool:
    return name.split("/")[1] in (ACTION, STATE)


def _rows(data: OpenedDataset) -> Iterator[tuple[int, dict[str, np.ndarray]]]:
    """Yield (number, columns) for each episode, with rows in the order of the files."""
    names = [*_ALWAYS, *(name for name in (ACTION, STATE) if name in data.features)]
    tables: list[dict[str, np.ndarray]] = []
    for path in sorted((data.root / "data").rglob("*.parquet")):
        try:
            table = pq.ParquetFile(path).read(columns=names)
            tables.append({name: _array(table.column(name)) for name in names})
        except (pa.ArrowException, OSError, ValueError, KeyError) as error:
            _unreadable(data, path, error)
    if not tables:
        return
    columns = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
    order = np.argsort(columns["episode_index"], kind="stable")
    numbers, starts = np.unique(columns["episode_index"][order], return_index=True)
    for number, places in zip(numbers, np.split(order, starts[1:]), strict=True):
        yield int(number), {name: values[places] for name, values in columns.items()}


def _array(column: pa.ChunkedArray) -> np.ndarray:
    values = column.combine_chunks()
    nested = False
    while pa.types.is_list(values.type) or pa.types.is_fixed_size_list(values.type):
        values, nested = values.flatten(), True
    array = values.to_numpy(zero_copy_only=False)
    return array.reshape(len(column), -1) if nested else array
