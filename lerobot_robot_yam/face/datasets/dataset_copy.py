"""Copies of a data set. A copy appears under its name only when complete, with renumbered side-car files.

`apply_labels` makes a copy without the episodes that are labelled as discarded, and adds two columns for the outcomes
of the other episodes. LeRobot's own functions drop the episodes and write `next.success`, which lerobot-dataset-viz
shows, in lerobot-eval's format: true in the last frame of a success. The column `success` of the episodes' metadata is
for `LeRobotDataset(…, episode_filter=lambda episode: episode["success"])`: true, false, or null without a label.
"""

import json
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from lerobot.datasets import LeRobotDataset, add_features, delete_episodes
from lerobot.utils.constants import SUCCESS as FRAME_COLUMN

from lerobot_robot_yam.errors import ConfigError, DatasetError, YamError
from lerobot_robot_yam.face.datasets.layout import Progress
from lerobot_robot_yam.face.recorder import outcomes
from lerobot_robot_yam.face.recorder.kept_episodes import SIDE_CAR, read_figures
from lerobot_robot_yam.face.recorder.outcomes import DISCARD, OUTCOMES, SUCCESS, Outcome

SIDE_CARS = (SIDE_CAR, OUTCOMES)  # this package's files beside a data set, with one row per episode
EPISODE_COLUMN = "success"  # name of the column in the episodes' metadata
_NAME = "local/labelled"  # name of the copy for LeRobot, which requires a name but does not store it


@contextmanager
def written_aside(target: Path) -> Iterator[Path]:
    """Yield a path for a new directory, which becomes `target` at the end, or is removed after an error.

    Other content of the same temporary directory is removed at the end.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    # new name: an existing directory belongs to somebody, and may be the data set that is being copied
    aside = Path(tempfile.mkdtemp(prefix=f"{target.name}.partial.", dir=target.parent))
    try:
        yield aside / "whole"  # a subdirectory, because only the owner can read `aside` itself
        (aside / "whole").rename(target)
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def copy_side_cars(root: Path, target: Path, kept: Sequence[int]) -> None:
    """Copy the figures and outcomes of the kept episodes, with their new numbers.

    Args:
        root: the data set.
        target: the copy; its directory meta exists.
        kept: numbers in `root` of the copy's episodes.

    Raises:
        ConfigError: a line of the outcomes file is invalid; the message names the line.
    """
    new_numbers = {old: new for new, old in enumerate(kept)}
    labels = outcomes.read(root)
    rows = [replace(label, episode_index=new_numbers[old]) for old, label in labels.items() if old in new_numbers]
    if rows:
        outcomes.append(target, rows)
    figures = [
        row | {"episode_index": new_numbers[old]} for old, row in read_figures(root).items() if old in new_numbers
    ]
    if figures:
        (target / SIDE_CAR).write_text("".join(json.dumps(row) + "\n" for row in figures), encoding="utf-8")


def verify(root: Path, progress: Progress = iter) -> None:
    """Load a data set as a training would, with the pictures of each episode's first and last frame.

    Raises:
        DatasetError: a part cannot be loaded or contradicts the metadata.
    """
    try:
        data = LeRobotDataset("local/verified", root=root, return_uint8=True, video_backend="pyav")
        rows = len(data.hf_dataset)
        if rows != len(data):
            raise ValueError(f"{rows} rows, the metadata count {len(data)}")
        for episode in progress(range(data.num_episodes)):
            row = data.meta.episodes[episode]
            first, last = row["dataset_from_index"], row["dataset_to_index"] - 1
            for index, frame in ((first, 0), (last, row["length"] - 1)):
                item = data[index]
                got = tuple(int(item[name]) for name in ("index", "episode_index", "frame_index"))
                if got != (index, episode, frame):
                    raise ValueError(f"row {index} should be frame {frame} of episode {episode}, it says {got}")
    except Exception as error:  # readers and decoders can raise any exception
        raise DatasetError(f"{root}: does not load: {type(error).__name__}: {error}") from error


def apply_labels(root: Path, target: Path, labels: Mapping[int, Outcome], progress: Progress = iter) -> None:
    """Write a copy with labels. The original is only read.

    Raises:
        ConfigError: no episode would remain, or the data set already is such a copy.
        DatasetError: the data set or the written copy cannot be loaded; `target` does not exist then.
    """
    try:
        with written_aside(target) as whole:
            _write(root, whole, labels, progress)
    except YamError:
        raise
    except Exception as error:  # LeRobot's functions and readers can raise any exception
        raise DatasetError(
            f"{root}: cannot be copied: {type(error).__name__}: {error}; if the recording was killed, "
            "yam-repair-dataset makes it load"
        ) from error


def _write(root: Path, whole: Path, labels: Mapping[int, Outcome], progress: Progress) -> None:
    data = LeRobotDataset(_NAME, root=root, video_backend="pyav")
    if FRAME_COLUMN in data.meta.features:
        raise ConfigError(f"{root} has a column {FRAME_COLUMN} already; label the recording that it was made from")
    dropped = [episode for episode, row in labels.items() if row.outcome == DISCARD]
    kept = [episode for episode in range(data.num_episodes) if episode not in dropped]
    if not kept:
        raise ConfigError(f"{root}: all {data.num_episodes} episodes are labelled {DISCARD}: nothing would be left")
    if dropped:
        data = delete_episodes(data, dropped, output_dir=whole.with_name("kept"), repo_id=_NAME)
    renumbered = {new: labels[old] for new, old in enumerate(kept) if old in labels}
    column = {"dtype": "bool", "shape": (1,), "names": None}
    add_features(data, {FRAME_COLUMN: (_frames(data, renumbered), column)}, whole, _NAME)
    _write_episode_column(whole, renumbered)
    copy_side_cars(root, whole, kept)
    verify(whole, progress)


def _frames(data: LeRobotDataset, labels: Mapping[int, Outcome]) -> np.ndarray:
    """Return (frames,) bool, true in the last frame of each success."""
    column = np.zeros(len(data), bool)
    for episode in data.meta.episodes:
        label = labels.get(episode["episode_index"])
        column[episode["dataset_to_index"] - 1] = label is not None and label.outcome == SUCCESS
    return column


def _write_episode_column(root: Path, labels: Mapping[int, Outcome]) -> None:
    for path in sorted((root / "meta" / "episodes").rglob("*.parquet")):
        table = pq.read_table(path)
        values = [
            labels[index].outcome == SUCCESS if index in labels else None
            for index in table["episode_index"].to_pylist()
        ]
        pq.write_table(table.append_column(EPISODE_COLUMN, pa.array(values, pa.bool_())), path)
