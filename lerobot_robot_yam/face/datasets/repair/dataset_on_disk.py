"""Description of a LeRobot data set (format v3) on disk: its episodes, and its problems as text."""

from dataclasses import dataclass, field
from pathlib import Path

import datasets
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from lerobot.datasets.feature_utils import get_hf_features_from_features
from lerobot.datasets.utils import DatasetInfo

from lerobot_robot_yam.face.datasets.repair.parquet_salvage import salvage


@dataclass
class Clip:
    """Location of an episode in a camera's videos, according to LeRobot's metadata."""

    chunk: int
    file: int
    start_s: float


@dataclass
class Episode:
    """Episode on disk. `lost` is the reason why the episode cannot be recovered, empty if it can be recovered."""

    number: int  # number of the episode when it was recorded
    path: Path  # data file, relative to the data set
    start: int  # index of the episode's first row in the data file
    length: int
    tasks: list[str]
    videos: dict[str, Clip] = field(default_factory=dict)
    stats: dict[str, dict[str, np.ndarray]] | None = None
    lost: str = ""


@dataclass
class Findings:
    """Episodes in a data set's directory in order, and the data set's problems as text."""

    root: Path
    info: DatasetInfo
    tasks: list[str]
    stats: dict[str, dict[str, np.ndarray]]  # statistics over all episodes; empty if the file cannot be read
    episodes: list[Episode] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    leftovers: list[str] = field(default_factory=list)  # files that no program reads, as text

    @property
    def kept(self) -> list[Episode]:
        return [episode for episode in self.episodes if not episode.lost]

    def keys(self, dtype: str) -> list[str]:
        """Return the names of the features of a type, such as "video" or "image"."""
        return [key for key, feature in self.info.features.items() if feature["dtype"] == dtype]

    def video(self, key: str, clip: Clip) -> Path:
        """Return the path of a clip's file, relative to the data set."""
        assert self.info.video_path is not None
        return Path(self.info.video_path.format(video_key=key, chunk_index=clip.chunk, file_index=clip.file))

    def read_data(self, path: Path, columns: list[str] | None = None) -> tuple[pa.Table, bool]:
        """Return a data file's rows, and whether the file is complete. A torn file yields complete row groups only."""
        try:
            return pq.ParquetFile(self.root / path).read(columns=columns), True
        except (pa.ArrowException, OSError):
            example = self._example()
            tables = salvage(self.root / path, example, columns)
            return pa.concat_tables(tables or [example.select(columns or example.column_names).slice(0, 0)]), False

    def _example(self) -> pa.Table:
        features = get_hf_features_from_features(self.info.features)
        row = {}
        for key in features:
            dtype, shape = (self.info.features[key][part] for part in ("dtype", "shape"))
            empty = None if dtype == "image" else "" if dtype == "string" else np.zeros(shape, dtype)
            row[key] = [empty.item() if isinstance(empty, np.ndarray) and shape == (1,) else empty]
        return datasets.Dataset.from_dict(row, features=features).with_format("arrow")[:]
