"""Rebuilding of a LeRobot data set from the findings of `inspection`, by LeRobot's own functions."""

import shutil
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from lerobot.datasets import LeRobotDatasetMetadata
from lerobot.datasets.io_utils import write_stats, write_table_one_row_group_per_episode

from lerobot_robot_yam.face.datasets.dataset_copy import SIDE_CARS, copy_side_cars, verify, written_aside
from lerobot_robot_yam.face.datasets.layout import Progress, clip_columns
from lerobot_robot_yam.face.datasets.repair.dataset_on_disk import Findings

_REPLACED = ("data", "videos", "images", "episodes")  # directories that are written anew, or are useless in the copy


def rebuild(findings: Findings, target: Path, progress: Progress = iter) -> None:
    """Write the recoverable episodes, numbered from 0, to a new directory. The original is only read.

    Raises:
        DatasetError: the written data set cannot be loaded; `target` is removed.
        ConfigError: the outcomes of the data set cannot be read.
    """
    with written_aside(target) as whole:
        _metadata(findings, whole)  # creates the directory
        copy_side_cars(findings.root, whole, [episode.number for episode in findings.kept])
        _rest(findings, whole)
        _data(findings, whole)
        _videos(findings, whole, progress)
        verify(whole, progress)


def _metadata(findings: Findings, target: Path) -> None:
    info = findings.info
    meta = LeRobotDatasetMetadata.create(
        "local/repaired",
        info.fps,
        info.features,
        robot_type=info.robot_type,
        root=target,
        use_videos=info.video_path is not None,
        chunks_size=info.chunks_size,
        data_files_size_in_mb=info.data_files_size_in_mb,
        video_files_size_in_mb=info.video_files_size_in_mb,
    )
    meta.info.tools = info.tools
    meta.save_episode_tasks(findings.tasks)
    for number, episode in enumerate(findings.kept):
        chunk, file = (int(part.rpartition("-")[2]) for part in (episode.path.parent.name, episode.path.stem))
        places: dict[str, Any] = {"data/chunk_index": chunk, "data/file_index": file}
        for key, clip in episode.videos.items():
            end_s = clip.start_s + episode.length / info.fps
            places |= dict(zip(clip_columns(key), (clip.chunk, clip.file, clip.start_s, end_s), strict=True))
        assert episode.stats is not None
        meta.save_episode(number, episode.length, episode.tasks, episode.stats, places)
    meta.finalize()
    frames = sum(episode.length for episode in findings.kept)
    if findings.stats.get("index", {}).get("count", np.zeros(1))[0] == frames:
        write_stats(findings.stats, target)  # LeRobot's own statistics are valid: they cover exactly these frames


def _rest(findings: Findings, target: Path) -> None:
    """Copy the other files of the data set: its card, notes, files of other packages."""
    for directory in (Path(), Path("meta")):
        for path in sorted((findings.root / directory).iterdir()):
            copy = target / directory / path.name
            if copy.exists() or directory / path.name in SIDE_CARS:
                continue
            if path.is_file():
                shutil.copy2(path, copy)
            elif path.is_dir() and path.name not in _REPLACED and not path.name.startswith("tmp"):
                shutil.copytree(path, copy, symlinks=True)


def _data(findings: Findings, target: Path) -> None:
    number = index = 0
    for path, episodes in groupby(findings.kept, key=lambda episode: episode.path):
        source, _ = findings.read_data(path)
        parts = []
        for episode in episodes:
            part = source.slice(episode.start, episode.length)
            values = {"episode_index": [number] * episode.length, "index": range(index, index + episode.length)}
            for name, column in values.items():
                place = part.schema.get_field_index(name)
                part = part.set_column(place, part.schema.field(place), pa.array(column, pa.int64()))
            parts.append(part)
            number, index = number + 1, index + episode.length
        (target / path).parent.mkdir(parents=True, exist_ok=True)
        write_table_one_row_group_per_episode(pa.concat_tables(parts), target / path)


def _videos(findings: Findings, target: Path, progress: Progress) -> None:
    used = {findings.video(key, clip) for episode in findings.kept for key, clip in episode.videos.items()}
    for path in progress(sorted(used)):
        (target / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(findings.root / path, target / path)
