"""Check of a whole data set, and its report."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import av
import numpy as np

from lerobot_robot_yam.face.datasets.check import motion_checks, picture_checks
from lerobot_robot_yam.face.datasets.check.flags import Flag, Kind
from lerobot_robot_yam.face.datasets.check.opened_dataset import (
    ACTION,
    STATE,
    OpenedDataset,
    RecordedEpisode,
    open_dataset,
)
from lerobot_robot_yam.face.datasets.check.row_checks import check_rows, statistics
from lerobot_robot_yam.face.datasets.dataset_pictures import Thumbnails, decode
from lerobot_robot_yam.face.datasets.layout import Progress, frame_count, is_depth, value_names


@dataclass
class EpisodeReport:
    number: int
    frames: int
    task: str
    flags: list[Flag] = field(default_factory=list)


@dataclass
class DatasetReport:
    """Flags for the data set's files and for each episode."""

    root: Path
    fps: float
    flags: list[Flag]
    episodes: list[EpisodeReport]

    @property
    def flagged(self) -> list[EpisodeReport]:
        return [episode for episode in self.episodes if episode.flags]

    @property
    def healthy(self) -> bool:
        return not self.flags and not self.flagged

    def to_dict(self) -> dict[str, Any]:
        episodes = [
            {
                "episode": episode.number,
                "healthy": not episode.flags,
                "frames": episode.frames,
                "task": episode.task,
                "flags": [flag.to_dict() for flag in episode.flags],
            }
            for episode in self.episodes
        ]
        flags = [flag.to_dict() for flag in self.flags]
        return {
            "path": str(self.root), "healthy": self.healthy, "fps": self.fps, "flags": flags, "episodes": episodes,
        }  # fmt: skip


def check_dataset(
    root: Path, *, every_s: float | None = 1.0, arm: str | None = None, progress: Progress = iter
) -> DatasetReport:
    """Check a data set, without changing it.

    Args:
        every_s: interval between checked pictures, s; 0: all pictures; None: no pictures.
        arm: profile with the joint limits; None: the widest limits of all arms.
        progress: wrapper of the loop over episodes.

    Raises:
        ConfigError: the directory is not a data set of format v3, or the arm is unknown.
    """
    data = open_dataset(root)
    report = DatasetReport(root, data.fps, [], [])
    check_into(report, data, every_s=every_s, arm=arm, progress=progress)
    return report


def check_into(
    report: DatasetReport,
    data: OpenedDataset,
    *,
    every_s: float | None = 1.0,
    arm: str | None = None,
    progress: Progress = iter,
) -> None:
    """Check an open data set as `check_dataset` does, adding to the report episode by episode.

    Swapped cameras are flagged last, because they can only be detected when all episodes are known.
    """
    report.flags += [*data.flags, *_set_flags(data)]
    views: dict[int, Mapping[str, np.ndarray]] = {}
    frame_counts: dict[Path, int] = {}
    for episode in progress(data.episodes):
        tasks = episode.metadata.get("tasks") or [""]
        found = EpisodeReport(episode.number, episode.length, str(tasks[0]), list(check_rows(data, episode)))
        report.episodes.append(found)
        if not episode.length:
            continue
        arms = _arms(data, episode)
        found.flags += _motion_flags(data, episode, arms, arm)
        if every_s is not None and episode.metadata:
            pictures: dict[str, Thumbnails] = {}
            for camera in data.cameras:
                found.flags += _video_flags(data, episode, camera, every_s, frame_counts, pictures)
            found.flags += _picture_flags(data, pictures, arms if _trusted(found.flags) else [])
            views[episode.number] = {name: shown.images.mean(axis=0) for name, shown in pictures.items()}
    by_number = {episode.number: episode for episode in report.episodes}
    for number, flag in picture_checks.swapped(views):
        by_number[number].flags.append(flag)


def _set_flags(data: OpenedDataset) -> Iterator[Flag]:
    said = data.info.get("total_episodes"), data.info.get("total_frames")
    there = len(data.episodes), sum(episode.length for episode in data.episodes)
    if said != there:
        text = "meta/info.json counts {} episodes with {} frames, there are {} with {}".format(*said, *there)
        yield Flag(Kind.COUNTS, text)
    for feature in (ACTION, STATE):
        values = [episode.rows[feature] for episode in data.episodes if feature in episode.rows]
        if values:
            yield from statistics(feature, data.statistics.get(feature, {}), np.concatenate(values))


def _trusted(flags: list[Flag]) -> bool:
    """Return whether an episode's states show real motion, because no flag says that their values are wrong."""
    return not {Kind.NOT_FINITE, Kind.UNITS, Kind.FRAMES} & {flag.kind for flag in flags}


def _arms(data: OpenedDataset, episode: RecordedEpisode) -> list[motion_checks.ArmMotion]:
    if ACTION not in episode.rows or STATE not in episode.rows:
        return []
    features = data.features[ACTION], data.features[STATE]
    return motion_checks.arms_of(episode.rows[ACTION], episode.rows[STATE], *features, data.unit)


def _motion_flags(
    data: OpenedDataset, episode: RecordedEpisode, arms: list[motion_checks.ArmMotion], profile: str | None
) -> list[Flag]:
    flags: list[Flag] = []
    for feature in (ACTION, STATE):
        if feature in episode.rows:
            flags += motion_checks.finite(feature, episode.rows[feature])
    if flags:
        return flags
    if ACTION in episode.rows:
        flags += motion_checks.constant(episode.rows[ACTION], data.fps)
    if any(data_names := value_names(data.features.get(STATE, {}))) and arms:
        flags += motion_checks.grippers(STATE, episode.rows[STATE], data_names)
        flags += motion_checks.grippers(ACTION, episode.rows[ACTION], value_names(data.features[ACTION]))
    wrong = list(motion_checks.units(arms, data.unit != 1.0))
    if wrong:
        return flags + wrong  # the remaining checks need the right unit
    for arm in arms:
        flags += motion_checks.jumps(arm, data.fps)
        flags += motion_checks.limits(arm, motion_checks.joint_limits(profile, arm.state.shape[1]))
        flags += motion_checks.frozen(arm, data.fps)
    return flags + list(motion_checks.apart(arms, data.fps))


def _video_flags(
    data: OpenedDataset,
    episode: RecordedEpisode,
    camera: str,
    every_s: float,
    frame_counts: dict[Path, int],
    pictures: dict[str, Thumbnails],
) -> Iterator[Flag]:
    """Decode a camera's pictures of an episode into `pictures`, and flag defects of its video."""
    clip = data.clip(episode, camera)
    if clip is None or not clip[0].is_file():
        yield Flag(Kind.VIDEO_MISSING, f"{camera}: no video" + ("" if clip is None else f" {clip[0].name}"))
        return
    path, start_s = clip
    if path not in frame_counts:
        frame_counts[path] = frame_count(path)
    there = frame_counts[path] - round(start_s * data.fps)
    if 0 < frame_counts[path] and there < episode.length:
        yield Flag(Kind.VIDEO_SHORT, f"{camera}: {max(there, 0)} pictures for {episode.length} rows")
        return
    try:
        shown = decode(path, start_s, episode.length, data.fps, max(round(every_s * data.fps), 1))
    except (av.FFmpegError, OSError, EOFError) as error:
        yield Flag(Kind.VIDEO_BROKEN, f"{camera}: {path.relative_to(data.root)}: {str(error)[:100]}")
        return
    if len(shown.frames):
        pictures[camera] = shown


def _picture_flags(
    data: OpenedDataset, pictures: Mapping[str, Thumbnails], arms: list[motion_checks.ArmMotion]
) -> Iterator[Flag]:
    colours = {camera: shown for camera, shown in pictures.items() if not is_depth(data.features[camera])}
    for camera, shown in pictures.items():
        yield from picture_checks.repeated(camera, shown, arms, data.fps)
    for camera, shown in colours.items():
        yield from picture_checks.exposure(camera, shown)
    yield from picture_checks.alike(colours)
