"""A copy of a data set in which the outcomes of its episodes count: without the discarded ones, and with columns.

LeRobot's own functions drop the episodes and write `next.success`, which lerobot-dataset-viz shows, in the form in
which lerobot-eval records it: true in the last frame of a success. The column `success` of the episodes' metadata is
what `LeRobotDataset(…, episode_filter=lambda episode: episode["success"])` reads: true, false, or null without a label.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from lerobot.datasets import LeRobotDataset, add_features, delete_episodes
from lerobot.utils.constants import SUCCESS as FRAME_COLUMN

from lerobot_robot_yam.errors import ConfigError, DatasetError, YamError
from lerobot_robot_yam.face.datasets.dataset_copy import copy_side_cars, written_aside
from lerobot_robot_yam.face.datasets.layout import Progress
from lerobot_robot_yam.face.datasets.repair.rebuild import verify
from lerobot_robot_yam.face.recorder.outcomes import DISCARD, SUCCESS, Outcome

EPISODE_COLUMN = "success"
_NAME = "local/labelled"  # LeRobot wants one, and stores it nowhere


def apply(root: Path, target: Path, labels: Mapping[int, Outcome], progress: Progress = iter) -> None:
    """Write the copy; the original is only read.

    Raises:
        ConfigError: nothing would be left, or it is such a copy already.
        DatasetError: it does not load, or what was written does not; `target` is not there.
    """
    try:
        with written_aside(target) as whole:
            _write(root, whole, labels, progress)
    except YamError:
        raise
    except Exception as error:  # LeRobot's functions and readers raise anything
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
    """(frames,) true in the last one of each success."""
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
