"""Disk space for a recording: a full disk loses even a finished episode."""

import contextlib
import logging
import shutil
from collections import deque
from pathlib import Path
from typing import Any

from lerobot_robot_yam.errors import ConfigError

logger = logging.getLogger(__name__)

_ROW = 1_000  # size of a frame's numbers, uncompressed, bytes
_VIDEO_PIXEL = 0.03  # size per pixel of a video with LeRobot's default settings, bytes: 0.01 to 0.03 with moving arms
_IMAGE_PIXEL = 1.5  # size per pixel of a PNG, bytes; frames are PNGs until their video is encoded
LEFT_FREE = 100_000_000  # space kept free for other programs and for closing the data set, bytes
_SPARE = 1.5  # safety factor on the size of the largest episode, because episodes differ
_LONG_S = 120.0  # maximum episode length for which space is planned, s: with a longer limit, a key ends episodes
_AT_LEAST_S = 10.0  # duration of a recording that has to fit at the start, s
_STILLS = "images"  # LeRobot's folder of images that are not encoded yet
_WINDOW_S = 300.0  # recorded time over which the rate is computed, s
_LEAST_S = 5.0  # minimum recorded time for computing a rate, s
_WARNED_S = 600.0  # remaining recording time at which a person is warned, s


class DiskGuard:
    """Monitor of the disk space for one recording.

    Args:
        root: folder of the data set.
        features: LeRobot's features of the data set.
        options: LeRobot's options of the data set: episodes, seconds, video.
        fps: the data set's frames per second.
    """

    def __init__(self, root: Path, features: dict[str, dict[str, Any]], options: Any, fps: int):
        self._root = root
        images = [feature for feature in features.values() if feature["dtype"] in ("video", "image")]
        pixels = sum(feature["shape"][0] * feature["shape"][1] for feature in images)
        self._kept = _ROW + pixels * (_VIDEO_PIXEL if options.video else _IMAGE_PIXEL)  # bytes per frame
        self._stills = 0.0 if not options.video or options.streaming_encoding else pixels * _IMAGE_PIXEL
        self._fps, self._frames = fps, int(min(options.episode_time_s, _LONG_S) * fps)
        self._before, self._largest = self._used(), 0

    def _used(self) -> int:
        """Return the size of the data set in bytes, without images that an encoder is about to remove."""
        used = 0
        for path in self._root.rglob("*"):
            with contextlib.suppress(OSError):  # removed in the meantime
                used += path.stat().st_size if _STILLS not in path.parts and path.is_file() else 0
        return used

    def free_bytes(self) -> int:
        """Return the number of bytes that this user may still write on the data set's disk."""
        return shutil.disk_usage(self._root).free

    def check(self, episodes: int) -> None:
        """Compare the space for `episodes` episodes with the free space at the start, and warn if it is too small.

        Raises:
            ConfigError: there is no space for 10 s of recording.
        """
        free = self.free_bytes() - LEFT_FREE
        if free < _AT_LEAST_S * self._fps * (self._kept + self._stills):
            raise ConfigError(
                f"the disk of {self._root} is full: {_text(self.free_bytes())} are free; make room, or choose another "
                "dataset.root"
            )
        room = int((free - self._frames * self._stills) / (self._frames * self._kept)) if self._frames else episodes
        if room < episodes:
            logger.warning(
                "%s are free in %s: room for about %d of %d episodes; the recording ends before the disk is full",
                _text(free),
                self._root,
                max(room, 0),
                episodes,
            )

    def saved(self, frames: int) -> None:
        """Record a saved episode of `frames` frames; the episode's size replaces the estimate."""
        used = self._used()
        self._largest, self._before = max(self._largest, used - self._before), used
        self._frames = max(self._frames if self._frames < _LONG_S * self._fps else 0, frames)

    @property
    def room_for_another(self) -> bool:
        """Whether another episode as large as the largest one fits."""
        kept = self._largest or self._frames * self._kept
        return self.free_bytes() - LEFT_FREE > _SPARE * (kept + self._frames * self._stills)


def _text(count: float) -> str:
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.0f} MB"


class DiskLeft:
    """Remaining recording time until the disk is full, at the rate at which the disk currently fills.

    Free bytes are compared at the start of recordings, because LeRobot encodes and removes images in between.
    """

    def __init__(self) -> None:
        self._begun = deque[tuple[float, int]]()  # for each recording: (seconds recorded before it, free bytes)
        self._recorded_s = self._looked_s = 0.0
        self._records = False

    def left_s(self, now_s: float, free: int, recording: bool) -> float | None:
        """Return the recording time until only `LEFT_FREE` is free, s; None if unknown, or if the disk does not fill.

        Args:
            now_s: monotonic time, s.
            free: free bytes on the disk.
            recording: whether the command is currently recording.
        """
        if recording and self._records:
            self._recorded_s += now_s - self._looked_s
        elif recording:
            self._begun.append((self._recorded_s, free))
            while len(self._begun) > 1 and self._recorded_s - self._begun[1][0] > _WINDOW_S:
                self._begun.popleft()
        self._looked_s, self._records = now_s, recording
        begun_s, before = self._begun[0] if self._begun else (0.0, free)
        if self._recorded_s - begun_s < _LEAST_S or free >= before:
            return None
        return max(free - LEFT_FREE, 0) * (self._recorded_s - begun_s) / (before - free)


def disk_warning(left_s: float | None, free: int) -> str:
    """Return the warning for a person, empty while there is space. Arguments as in `DiskLeft.left_s`."""
    if free < LEFT_FREE:
        return "the disk is full: the recording ends"
    if left_s is not None and left_s < _WARNED_S:
        return f"the disk is full in {left_s / 60.0:.1f} min of recording: make room, or end before"
    return ""
