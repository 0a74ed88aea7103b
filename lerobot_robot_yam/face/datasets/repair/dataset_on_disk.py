"""Description of a LeRobot data set (format v3) as it lies on disk, in words and numbers."""

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
    """An episode's place in a camera's videos, by LeRobot's metadata."""

    chunk: int
    file: int
    start_s: float


@dataclass
class Episode:
    """One episode; `lost` is the reason why it cannot be recovered, empty if it can."""

    number: int  # as recorded
    path: Path  # data file, relative to the data set
    start: int  # its first row in there
    length: int
    tasks: list[str]
    videos: dict[str, Clip] = field(default_factory=dict)
    stats: dict[str, dict[str, np.ndarray]] | None = None
    lost: str = ""


@dataclass
class Findings:
    """Episodes of a data set's directory in their order, and its problems in words."""

    root: Path
    info: DatasetInfo
    tasks: list[str]
    stats: dict[str, dict[str, np.ndarray]]  # for all episodes together; empty if they cannot be read
    episodes: list[Episode] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    leftovers: list[str] = field(default_factory=list)  # files that no program reads, in words

    @property
    def kept(self) -> list[Episode]:
        return [episode for episode in self.episodes if not episode.lost]

    def keys(self, dtype: str) -> list[str]:
        """Return the names of the features of a type: "video", "image"."""
        return [key for key, feature in self.info.features.items() if feature["dtype"] == dtype]

    def video(self, key: str, clip: Clip) -> Path:
        """Return the path of a clip's file, relative to the data set."""
        assert self.info.video_path is not None
        return Path(self.info.video_path.format(video_key=key, chunk_index=clip.chunk, file_index=clip.file))

    def read_data(self, path: Path, columns: list[str] | None = None) -> tuple[pa.Table, bool]:
        """Read a data file, and whether it is whole; of a torn one, the complete row groups (one per episode)."""
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
