"""Inspection of a LeRobot data set (format v3) on disk, in any state that its recording may have left.

LeRobot's writer keeps one data file and one file of episode metadata open for a whole session and writes their footers
at the session's end; the metadata of up to ten episodes are only in memory. After a kill -9 therefore nothing loads,
not even the saved episodes. But their rows and videos are on disk: rows are read page by page (`parquet_salvage`), and
the episodes' locations in the cameras' videos follow from the episodes' lengths, because videos are appended in order.
"""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import av
import datasets
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from lerobot.configs import DepthEncoderConfig
from lerobot.datasets.compute_stats import (
    auto_downsample_height_width,
    compute_episode_stats,
    get_feature_stats,
    sample_indices,
)
from lerobot.datasets.depth_utils import dequantize_depth
from lerobot.datasets.io_utils import cast_stats_to_numpy, load_info, load_stats, load_tasks
from lerobot.datasets.video_utils import decode_video_frames

from lerobot_robot_yam.errors import DatasetError
from lerobot_robot_yam.face.datasets.layout import Progress, clip_columns, frame_count, is_depth
from lerobot_robot_yam.face.datasets.repair.dataset_on_disk import Clip, Episode, Findings

_INTERRUPTED = "{}: rows of an episode {} whose saving was interrupted"
_TOLERANCE_S = 1e-4  # maximum difference between a frame's timestamp and its time in the video, s, as in LeRobot
_BATCH = 16  # number of frames decoded at once: LeRobot's decoder keeps all frames between the first and the last


def inspect(root: Path, progress: Progress = iter) -> Findings:
    """Inspect a data set without changing it. progress: wrapper of the loop that decodes videos.

    Raises:
        DatasetError: a file that describes the format of the data is missing.
    """
    try:
        name = "meta/info.json"
        info = load_info(root)
        if not any((root / "data").glob("*/*.parquet")) and not info.total_episodes:
            raise DatasetError(f"{root}: no episode was saved before the recording ended; there is nothing to recover")
        name = "meta/tasks.parquet"
        tasks = [str(task) for task in load_tasks(root).sort_values("task_index").index]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DatasetError(
            f"{root}: {error}. There is one {name}, and the columns mean what it says; if a data set of the same "
            "recording config has it, copy it here and try again"
        ) from error
    findings = Findings(root, info, tasks, _stats(root))
    rows = _metadata(findings)
    for path in sorted((root / "data").glob("*/*.parquet")):
        findings.episodes += _episodes(findings, path.relative_to(root), rows)
    found = {episode.number for episode in findings.episodes}
    for number in sorted({*rows, *range(info.total_episodes)} - found):
        findings.episodes.append(Episode(number, Path(), 0, 0, [], lost="its rows are not on disk"))
    for key in findings.keys("video"):
        _place(findings, key)
    for episode in progress(findings.kept):
        try:
            _check(findings, episode)
        except DatasetError as error:
            episode.lost = str(error)
    kept = findings.kept
    if (info.total_episodes, info.total_frames) != (len(kept), sum(episode.length for episode in kept)):
        findings.problems.append(
            f"meta/info.json: counts {info.total_episodes} episodes with {info.total_frames} frames, there are "
            f"{len(kept)} with {sum(episode.length for episode in kept)}"
        )
    if (root / "images").is_dir():
        findings.leftovers.append("images: frames that no video was made of; they stay there")
    for path in sorted(root.glob("tmp*")):
        findings.leftovers.append(f"{path.name}: left by the episode that was being recorded; its rows were in memory")
    return findings


def _stats(root: Path) -> dict[str, dict[str, np.ndarray]]:
    try:
        return load_stats(root) or {}
    except (OSError, ValueError):
        return {}


def _metadata(findings: Findings) -> dict[int, dict[str, Any]]:
    """Return LeRobot's readable metadata of the episodes: episode number → row."""
    rows: dict[int, dict[str, Any]] = {}
    for path in sorted((findings.root / "meta" / "episodes").glob("*/*.parquet")):
        try:
            rows |= {row["episode_index"]: row for row in pq.ParquetFile(path).read().to_pylist()}
        except (pa.ArrowException, OSError):
            findings.problems.append(f"{path.relative_to(findings.root)}: has no footer, its writer was killed")
    missing = findings.info.total_episodes - len(rows)
    if missing > 0:
        findings.problems.append(f"meta/episodes: of {missing} saved episodes the metadata are missing")
    return rows


def _episodes(findings: Findings, path: Path, rows: dict[int, dict[str, Any]]) -> Iterator[Episode]:
    names = ["episode_index", "frame_index", "index", "task_index"]
    table, whole = findings.read_data(path, names)
    numbers, frames, indices, tasks = (table.column(name).to_numpy() for name in names)
    cuts = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), len(numbers)]
    spans = [(start, stop) for start, stop in pairwise(cuts) if stop > start]
    if not whole:
        findings.problems.append(f"{path}: has no footer, its writer was killed; {len(spans)} episodes are complete")
    again = {int(numbers[start]) for start, _ in spans}.difference(rows)  # LeRobot reuses such a number
    for episode in [episode for episode in findings.episodes if episode.number in again]:
        findings.problems.append(_INTERRUPTED.format(episode.path, episode.number))
        findings.episodes.remove(episode)
    next_index = sum(episode.length for episode in findings.episodes)
    for start, stop in spans:
        number, length = int(numbers[start]), stop - start
        row = rows.get(number)
        if row is not None and (_data_path(findings, row), row["length"]) != (path, length):
            findings.problems.append(_INTERRUPTED.format(path, number))
            continue
        done = dict.fromkeys(tasks[start:stop].tolist())
        episode = Episode(number, path, start, length, [task for n, task in enumerate(findings.tasks) if n in done])
        if len(episode.tasks) < len(done) or not np.array_equal(frames[start:stop], np.arange(length)):
            episode.lost = "its rows are not complete"
        if indices[start] != next_index:
            findings.problems.append(f"{path}: episode {number} begins at index {indices[start]}, not {next_index}")
        next_index += length
        if row is not None:
            for key in findings.keys("video"):
                place = clip_columns(key)[:3]
                # LeRobot saves the row before the video if it encodes the videos of several episodes at once.
                if all(row.get(name) is not None for name in place):
                    episode.videos[key] = Clip(*(row[name] for name in place))
            flat = {name.split("/", 1)[1]: value for name, value in row.items() if name.startswith("stats/")}
            episode.stats = cast_stats_to_numpy(flat) if flat else None
        yield episode


def _data_path(findings: Findings, row: dict[str, Any]) -> Path:
    chunk, file = row["data/chunk_index"], row["data/file_index"]
    return Path(findings.info.data_path.format(chunk_index=chunk, file_index=file))


def _place(findings: Findings, key: str) -> None:
    """Locate the clips of a camera's episodes without metadata, in video files that no metadata mention."""
    taken = {findings.video(key, episode.videos[key]) for episode in findings.episodes if key in episode.videos}
    waiting = [episode for episode in findings.episodes if key not in episode.videos and episode.length]
    for path in sorted((findings.root / "videos" / key).glob("*/*.mp4")):
        relative = path.relative_to(findings.root)
        if relative in taken:
            continue
        chunk, file = (int(part.rpartition("-")[2]) for part in (path.parent.name, path.stem))
        frames, here, at = frame_count(path), [], 0
        while waiting and at + waiting[0].length <= frames:
            here.append(waiting.pop(0))
            here[-1].videos[key] = Clip(chunk, file, at / findings.info.fps)
            at += here[-1].length
        if at != frames or not frames:
            for episode in [*here, *waiting]:
                episode.lost = episode.lost or (
                    f"{relative} has {frames} frames, which no number of episodes adds up to: frames were dropped "
                    "or cut off, and it cannot be told whose"
                )
            return
    for episode in waiting:
        episode.lost = episode.lost or f"no video of {key}: killed while it was being saved, or before it was encoded"


def _check(findings: Findings, episode: Episode) -> None:
    """Decode the first and the last frame of an episode in each video. Compute missing statistics.

    Raises:
        DatasetError: a video cannot be decoded.
    """
    if episode.stats is not None:
        for key, clip in episode.videos.items():
            for index in (0, episode.length - 1):
                _frames(findings, key, clip, [index])
        return
    features, chosen = findings.info.features, sample_indices(episode.length)
    table = findings.read_data(episode.path)[0].slice(episode.start, episode.length)
    numeric = {
        key: np.array(table.column(key).to_pylist(), features[key]["dtype"])
        for key in table.column_names
        if features[key]["dtype"] not in ("image", "string", "language")
    }
    stats = compute_episode_stats(numeric, features)
    pictures = {key: _frames(findings, key, clip, chosen) for key, clip in episode.videos.items()}
    for key in findings.keys("image"):
        cells = table.column(key).take(chosen)
        pictures[key] = _small(np.stack([_channels_first(datasets.Image().decode_example(c.as_py())) for c in cells]))
    for key, images in pictures.items():
        scale = 1.0 if is_depth(features[key]) else 255.0
        raw = get_feature_stats(images, axis=(0, 2, 3), keepdims=True)
        stats[key] = {name: np.squeeze(value / scale, axis=0) for name, value in raw.items() if name != "count"}
        # LeRobot weights episodes by this count: pixels if it encoded while recording, otherwise sampled pictures.
        in_pixels = key in findings.stats and findings.stats[key]["count"][0] > findings.info.total_frames
        stats[key]["count"] = np.array([episode.length * images[0, 0].size if in_pixels else len(images)])
    episode.stats = stats


def _frames(findings: Findings, key: str, clip: Clip, indices: list[int]) -> np.ndarray:
    """Return frames of an episode (n, channels, height, width), downsampled as for LeRobot's statistics.

    Raises:
        DatasetError: the frames cannot be decoded.
    """
    info = findings.info.features[key].get("info") or {}
    depth, path = is_depth(findings.info.features[key]), findings.root / findings.video(key, clip)
    found = []
    for first in range(0, len(indices), _BATCH):
        exact = np.array(indices[first : first + _BATCH]) / findings.info.fps
        times = [clip.start_s + time for time in exact.astype(np.float32).tolist()]  # float32, as in LeRobot
        try:
            frames = decode_video_frames(path, times, _TOLERANCE_S, "pyav", return_uint8=True, is_depth=depth)
        except (av.FFmpegError, OSError, ValueError, RuntimeError, IndexError) as error:
            why = str(error).partition("\n")[0][:120]
            raise DatasetError(f"{path.relative_to(findings.root)} cannot be decoded: {why}") from error
        if depth:
            coding = DepthEncoderConfig.from_video_info(info)
            limits = {name: getattr(coding, name) for name in ("depth_min", "depth_max", "shift", "use_log")}
            frames = dequantize_depth(frames, **limits, output_unit=info.get("depth_unit") or "mm")
        found.append(_small(frames.numpy()))
    return np.concatenate(found)


def _small(images: np.ndarray) -> np.ndarray:
    return np.stack([auto_downsample_height_width(image) for image in images])


def _channels_first(image: Any) -> np.ndarray:
    array = np.asarray(image)
    return array[None] if array.ndim == 2 else array.transpose(2, 0, 1)
