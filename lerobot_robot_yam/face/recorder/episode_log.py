"""Log of a `lerobot-record` by its robot: a log line and a row of figures for each episode, and a disk monitor.

An error in this module never ends a recording.
"""

import json
import logging
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from lerobot_robot_yam.face.lerobot_command.running_command import Phase, Situation, recording
from lerobot_robot_yam.face.recorder.disk_guard import LEFT_FREE, DiskGuard
from lerobot_robot_yam.face.recorder.kept_episodes import SIDE_CAR, tell_what_is_kept
from lerobot_robot_yam.state.arm_state import ArmState
from lerobot_robot_yam.state.records import Limited

logger = logging.getLogger(__name__)

_LOOK_S = 0.5  # interval between checks of the disk, and between status lines, s
_LATE = 1.5  # number of periods after which a frame counts as late
_SAMPLE = 16  # step between rows and columns that are compared first, pixels
_SLOW = 0.95  # fraction of the data set's frames per second below which an episode is slow
_CLEAR = "\r\x1b[K"  # control characters that clear a terminal's line


@dataclass
class EpisodeFigures:
    """Figures of one episode that a training cannot see in the frames, collected while the episode is recorded.

    Attributes:
        index: number of the episode.
        fps: the data set's frames per second.
        begun: date and time of the start, ISO 8601 with the time zone.
        times_s: monotonic time of each frame.
        images: newest image of each camera.
        repeated: camera → number of frames with the same image as the previous frame.
        lost: number of motor replies lost in the episode, all arms together.
        held_back: number of frames in which the speed limit kept an arm behind its target.
        changed: number of actions that limits changed before they were sent.
    """

    index: int
    fps: int
    begun: str
    times_s: list[float] = field(default_factory=list)
    images: dict[str, Any] = field(default_factory=dict)
    repeated: Counter[str] = field(default_factory=Counter)
    lost: int = 0
    held_back: int = 0
    changed: int = 0

    def add_frame(self, now_s: float, images: Mapping[str, Any], held_back: bool) -> None:
        self.times_s.append(now_s)
        self.repeated.update(name for name, image in images.items() if _same(self.images.get(name), image))
        self.images = dict(images)
        self.held_back += held_back

    @property
    def frames(self) -> int:
        return len(self.times_s)

    @property
    def achieved_fps(self) -> float:
        """Real frames per second; with fewer than two frames the data set's number."""
        return (self.frames - 1) / (self.times_s[-1] - self.times_s[0]) if self.frames > 1 else float(self.fps)

    @property
    def late_frames(self) -> int:
        """Number of frames that came more than half a period late."""
        return int((np.diff(self.times_s) > _LATE / self.fps).sum())

    @property
    def slow(self) -> bool:
        """Whether the recording was slower than its timestamps, so that a training sees the motion too fast."""
        return self.achieved_fps < _SLOW * self.fps

    def summary(self) -> str:
        """Return a one-line summary for a person."""
        rate = f" at {self.achieved_fps:.1f} of {self.fps} fps" if self.frames > 1 else ""
        found = [f"{self.frames} frame{'s' * (self.frames != 1)}{rate}"]
        if self.late_frames:
            found.append(f"{self.late_frames} late (longest {np.diff(self.times_s).max() * 1e3:.0f} ms)")
        found += [f"{count} repeated images of {name}" for name, count in sorted(self.repeated.items())]
        if self.lost:
            found.append(f"{self.lost} lost replies of motors")
        if self.held_back:
            found.append(f"{self.held_back / self.frames:.0%} of frames at the speed limit")
        if self.changed:
            found.append(f"{self.changed} actions changed by limits")
        return f"episode {self.index}: {', '.join(found)}"

    def row(self) -> dict[str, Any]:
        """Return the row for the side-car file, with times in s since the first frame."""
        times = np.array(self.times_s) - (self.times_s[0] if self.times_s else 0.0)
        return {
            "episode_index": self.index,
            "begun": self.begun,
            "fps": self.fps,
            "achieved_fps": round(self.achieved_fps, 3),
            "frames": self.frames,
            "late_frames": self.late_frames,
            "repeated_images": dict(self.repeated),
            "lost_replies": self.lost,
            "frames_at_speed_limit": self.held_back,
            "changed_actions": self.changed,
            "times_s": np.round(times, 4).tolist(),
        }


def _same(before: Any, image: Any) -> bool:
    """Return whether two images are equal. A sample of pixels detects most differences within microseconds."""
    if before is None or before.shape != image.shape:
        return False
    return np.array_equal(before[::_SAMPLE, ::_SAMPLE], image[::_SAMPLE, ::_SAMPLE]) and np.array_equal(before, image)


class StatusLine(logging.Filter):
    """Status line at the bottom of a terminal with the progress of the recording, below the log.

    The line is shown only on a terminal. As a log filter it is cleared before each record, and passes all records.

    stream: stream of the log; by default standard error.
    """

    def __init__(self, stream: TextIO | None = None):
        super().__init__()
        self._stream = stream or sys.stderr
        self._on = self._stream is not None and self._stream.isatty()  # the stream may be None in a GUI program
        self._shown = False

    def begin(self) -> None:
        for handler in logging.getLogger().handlers if self._on else ():
            handler.addFilter(self)

    def show(self, text: str) -> None:
        """Replace the line. The cursor returns to the start of the line, so that other output replaces it, too."""
        if self._on:
            self._write(f"{_CLEAR}{text}\r")
            self._shown = self._on

    def _write(self, text: str) -> None:
        """Write without ever failing: the terminal may be closed while arms must land, and a signal may interrupt."""
        try:
            self._stream.write(text)
            self._stream.flush()
        except (OSError, ValueError, RuntimeError):
            self._on = False

    def filter(self, record: logging.LogRecord) -> bool:
        """Clear the line before a log record."""
        self.clear()
        return True

    def clear(self) -> None:
        if self._shown:
            self._shown = False
            self._write(_CLEAR)

    def end(self) -> None:
        """Clear the line, and detach from the log."""
        self.clear()
        for handler in logging.getLogger().handlers:
            handler.removeFilter(self)


class EpisodeLog:
    """Log of the episodes of one robot, from connect to disconnect. Does nothing under other commands."""

    def __init__(self) -> None:
        self._command: Situation | None = None
        self._status = StatusLine()

    def begin(self) -> None:
        """Start the log, before the arms are energised. Raises ConfigError: the disk is full."""
        self._figures: EpisodeFigures | None = None
        self._told = False  # whether the current episode's line is logged
        self._first = self._lost_before = 0
        self._looked_s = self._loop_began_s = 0.0
        tell_what_is_kept()
        self._command = command = recording()
        if command is None:
            return
        dataset, options = command.dataset, command.config.dataset
        self._first = dataset.num_episodes
        self._guard = DiskGuard(Path(dataset.root), dataset.features, options, dataset.fps)
        self._guard.check(options.num_episodes)
        self._status.begin()

    def observed(self, states: Sequence[ArmState], images: Mapping[str, Any]) -> None:
        """Count an observation, which LeRobot records in an episode."""
        if self._command is not None:
            self._carefully(lambda: self._observed(recording(), states, images))

    def sent(self, changed: bool) -> None:
        """Count a sent action. changed: whether limits have changed the action."""
        if self._figures is not None and self._command is not None and self._command.phase is Phase.RECORDING:
            self._figures.changed += changed

    def end(self) -> None:
        """Finish the log when the data set is closed, or stayed empty. Idempotent."""
        if self._command is not None:
            self._carefully(self._finish)
        self._command = None
        self._status.end()

    def _carefully(self, work: Callable[[], None]) -> None:
        try:
            work()
        except Exception as error:
            logger.warning("no figures of episodes from now on: %r", error)
            self._command = None

    def _observed(self, command: Situation | None, states: Sequence[ArmState], images: Mapping[str, Any]) -> None:
        if command is None or self._command is None:
            return
        if command.turn != self._command.turn:
            self._turn(command, states)
        self._command = command
        now_s = time.monotonic()
        if command.phase is Phase.RECORDING and self._figures is not None:
            self._figures.add_frame(now_s, images, any(state.limited & Limited.SPEED for state in states))
            self._figures.lost = _lost(states) - self._lost_before
        if now_s - self._looked_s > _LOOK_S:
            self._looked_s = now_s
            self._look(command, now_s - self._loop_began_s)

    def _look(self, command: Situation, elapsed_s: float) -> None:
        """Update the status line, and end an episode that would fill the disk."""
        options, free = command.config.dataset, self._guard.free_bytes()
        if command.phase is Phase.RECORDING and free < LEFT_FREE:
            logger.warning("the disk of %s is almost full: the recording ends now", command.dataset.root)
            command.stop()
        if command.phase is Phase.RECORDING and self._figures is not None:
            what = f"episode {self._figures.index} ({self._figures.index - self._first + 1} of {options.num_episodes})"
            left_s, rate = options.episode_time_s - elapsed_s, f"{self._figures.achieved_fps:.1f} fps, "
        else:
            what, left_s, rate = "reset the scene", options.reset_time_s - elapsed_s, ""
        self._status.show(f"{what}: {max(left_s, 0.0):.0f} s left, {rate}{free / 1e9:.0f} GB free")

    def _turn(self, command: Situation, states: Sequence[ArmState]) -> None:
        """Handle a new run of LeRobot's loop."""
        self._loop_began_s = time.monotonic()
        self._tell()
        if command.phase is not Phase.RECORDING:  # a reset, after which the recorded episode is saved
            return
        self._keep()
        index = command.dataset.num_episodes
        if index > self._first and not self._guard.room_for_another:
            logger.warning("the disk of %s has no room for another episode: the recording ends", command.dataset.root)
            command.stop()
            command.discard()  # the episode that has just begun
        begun = datetime.now().astimezone().isoformat(timespec="milliseconds")
        self._figures, self._told = EpisodeFigures(index, command.dataset.fps, begun), False
        self._lost_before = _lost(states)

    def _finish(self) -> None:
        self._tell()
        self._keep()

    def _tell(self) -> None:
        figures = self._figures
        if figures is not None and not self._told and figures.frames:
            self._told = True
            logger.log(logging.WARNING if figures.slow else logging.INFO, "%s", figures.summary())

    def _keep(self) -> None:
        """Write the figures of the previous episode, if LeRobot has saved the episode."""
        figures, self._figures = self._figures, None
        if figures is None or self._command is None:
            return
        dataset = self._command.dataset
        if dataset.num_episodes <= figures.index:
            logger.info("episode %d is not kept", figures.index)
            return
        with open(dataset.root / SIDE_CAR, "a", encoding="utf-8") as file:
            file.write(json.dumps(figures.row()) + "\n")
        self._guard.saved(figures.frames)


def _lost(states: Sequence[ArmState]) -> int:
    return sum(sum(state.lost) for state in states)
