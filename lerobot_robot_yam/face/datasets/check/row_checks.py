"""Checks of an episode's rows, timestamps and statistics. Each check yields flags for the defects found."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from lerobot_robot_yam.face.datasets.check.flags import Flag, Kind
from lerobot_robot_yam.face.datasets.check.opened_dataset import ACTION, STATE, OpenedDataset, RecordedEpisode

SHORT_S = 0.5  # duration below which an episode is short, s
PAUSE_S = 0.5  # maximum delay of a frame, s
# LATE_PERIODS: periods after which a frame is late; LATE_SHARE: fraction of late frames from which they are flagged
LATE_PERIODS, LATE_SHARE = 1.5, 0.05
RATE_TOLERANCE = 0.05  # maximum relative difference between the real rate and the stamped rate
REPEATED_SHARE = 0.3  # fraction of repeated images from which a camera is slow
OFF_GRID_FRAMES = 0.5  # maximum distance between a timestamp and its frame, periods: beyond it another frame is nearer
STATISTICS_TOLERANCE = 1e-3  # maximum error of a statistic, as a fraction of the value's range


def check_rows(data: OpenedDataset, episode: RecordedEpisode) -> Iterator[Flag]:
    """Run all checks of this module on one episode."""
    if not episode.length:
        yield Flag(Kind.NO_ROWS, "its rows are not on disk")
        return
    if not episode.metadata:
        yield Flag(Kind.NO_METADATA, "its metadata are missing")
    else:
        yield from _lengths(episode)
    yield from frame_numbers(episode.rows["frame_index"])
    yield from _task(data, episode)
    if episode.length < SHORT_S * data.fps:
        yield Flag(Kind.SHORT, f"{episode.length} frames, {episode.length / data.fps:.2f} s")
    yield from stamps(episode.rows["timestamp"], episode.rows["frame_index"], data.fps)
    yield from real_times(episode.figures, data.fps)
    for feature in (ACTION, STATE):
        if feature in episode.rows:
            yield from statistics(feature, episode.metadata.get("stats", {}).get(feature, {}), episode.rows[feature])


def _lengths(episode: RecordedEpisode) -> Iterator[Flag]:
    said = episode.metadata["length"]
    if said != episode.length:
        yield Flag(Kind.LENGTH, f"the metadata say {said} frames, there are {episode.length} rows")
    first, begin = int(episode.rows["index"][0]), episode.metadata["dataset_from_index"]
    steps = np.diff(episode.rows["index"])
    if first != begin:
        yield Flag(Kind.INDEX, f"its first row has index {first}, the metadata say {begin}")
    elif (steps != 1).any():
        at = int(np.argmax(steps != 1))
        yield Flag(Kind.INDEX, f"index goes from {first + at} to {int(episode.rows['index'][at + 1])}", (at, at + 1))


def frame_numbers(frame_index: np.ndarray) -> Iterator[Flag]:
    """Flag a `frame_index` (n,) that is not 0, 1, 2 …."""
    missing = np.setdiff1d(np.arange(int(frame_index.max()) + 1), frame_index)
    doubled = len(frame_index) - len(np.unique(frame_index))
    if len(missing) or doubled:
        first = int(missing[0]) if len(missing) else int(np.argmax(np.diff(frame_index) <= 0))
        yield Flag(Kind.FRAMES, f"{len(missing)} frames are dropped, {doubled} are doubled", (first, first))
    elif (np.diff(frame_index) != 1).any():
        yield Flag(Kind.FRAMES, "frames are not in their order")


def _task(data: OpenedDataset, episode: RecordedEpisode) -> Iterator[Flag]:
    used = np.unique(episode.rows["task_index"]).tolist()
    wrong = [number for number in used if not str(data.tasks.get(number) or "").strip()]
    if wrong:
        yield Flag(Kind.TASK, f"task {wrong[0]} has no text in meta/tasks.parquet")


def stamps(timestamp: np.ndarray, frame_index: np.ndarray, fps: float) -> Iterator[Flag]:
    """Flag timestamps (n,) in s that do not increase, or are not frame_index / fps."""
    steps = np.diff(timestamp)
    if not np.isfinite(timestamp).all() or (steps <= 0).any():
        at = int(np.argmax(~(steps > 0)))
        yield Flag(Kind.NOT_MONOTONE, f"the time stamp after frame {at} does not grow", (at, at + 1))
        return
    off = np.abs((timestamp - timestamp[0]) * fps - (frame_index - frame_index[0]))
    if (off > OFF_GRID_FRAMES).any():
        at = int(np.argmax(off > OFF_GRID_FRAMES))
        yield Flag(
            Kind.CADENCE,
            f"time stamps come at {1 / np.median(steps):.1f} fps, the data set says {fps:g}",
            (at, len(timestamp) - 1),
        )


def real_times(figures: Mapping[str, Any], fps: float) -> Iterator[Flag]:
    """Flag a wrong real rate, late frames and repeated images, from the figures in the side-car file."""
    times = np.asarray(figures.get("times_s", ()), float)
    if len(times) < 2:
        return
    steps = np.diff(times)
    rate = len(steps) / (times[-1] - times[0])
    if abs(rate / fps - 1) > RATE_TOLERANCE:
        yield Flag(Kind.REAL_RATE, f"recorded at {rate:.1f} fps, stamped with {fps:g}")
    late = steps > LATE_PERIODS / fps
    if late.mean() > LATE_SHARE or (steps > PAUSE_S + 1 / fps).any():
        at = int(np.argmax(steps))
        yield Flag(Kind.LATE, f"{late.sum()} frames came late, the longest after {steps[at]:.2f} s", (at, at + 1))
    for camera, count in sorted(figures.get("repeated_images", {}).items()):
        if count > REPEATED_SHARE * len(times):
            yield Flag(Kind.CAMERA_SLOW, f"{camera}: {count} of {len(times)} images repeat the one before")


def statistics(feature: str, said: Mapping[str, Any], values: np.ndarray) -> Iterator[Flag]:
    """Flag LeRobot's minimum, maximum or mean (k,) if it does not match the values (n, k)."""
    if not np.isfinite(values).all():
        return  # `finite` flags such values
    low, high = values.min(axis=0), values.max(axis=0)
    slack = STATISTICS_TOLERANCE * (high - low) + 1e-5 * (1.0 + np.abs(high))
    for name, real in (("min", low), ("max", high), ("mean", values.mean(axis=0, dtype=np.float64))):
        if name not in said:
            continue
        written = np.ravel(said[name])
        if written.shape != real.shape or not (np.abs(written - real) <= slack).all():
            yield Flag(Kind.STATISTICS, f"{name} of {feature} is not that of the rows")
            return
