"""Watches a `lerobot-record` from its robot: a line and a row of figures for each episode, and the disk.

Nothing that goes wrong in here ends a recording.
"""

import json
import logging
import time
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from types import FrameType
from typing import Any

from lerobot_robot_yam.face.recorder.disk_guard import LEFT_FREE, DiskGuard
from lerobot_robot_yam.face.recorder.episode_figures import EpisodeFigures
from lerobot_robot_yam.face.recorder.record_command import RecordCommand, running_record, tell_what_is_kept
from lerobot_robot_yam.face.recorder.status_line import StatusLine
from lerobot_robot_yam.state.records import ArmState, Limited

logger = logging.getLogger(__name__)

SIDE_CAR = Path("meta", "yam_episodes.jsonl")
_LOOK_S = 0.5  # between two looks at the disk, and two status lines


class EpisodeLog:
    """Of one robot, from its connect to its disconnect. Does nothing under other commands.

    Args:
        frame: the robot's, before its arms are energised.

    Raises:
        ConfigError: the disk is full.
    """

    def __init__(self, frame: FrameType | None) -> None:
        self._figures: EpisodeFigures | None = None
        self._told = False  # of the present episode
        self._first = self._lost_before = 0
        self._looked_s = self._loop_began_s = 0.0
        self._status = StatusLine()
        tell_what_is_kept(frame)
        self._command = command = running_record(frame)
        if command is None:
            return
        dataset = command.dataset
        self._first = dataset.num_episodes
        self._guard = DiskGuard(Path(dataset.root), dataset.features, command.options, dataset.fps)
        self._guard.check(command.options.num_episodes)
        self._status.begin()

    def observed(self, frame: FrameType | None, states: Sequence[ArmState], images: Mapping[str, Any]) -> None:
        """One observation, which LeRobot records if an episode is on."""
        if self._command is not None:
            self._carefully(lambda: self._observed(running_record(frame), states, images))

    def sent(self, changed: bool) -> None:
        """An action was sent; changed: not as it was given."""
        if self._figures is not None and self._command is not None and self._command.records:
            self._figures.changed += changed

    def end(self) -> None:
        """The data set is closed, or was never filled. Idempotent."""
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

    def _observed(self, command: RecordCommand | None, states: Sequence[ArmState], images: Mapping[str, Any]) -> None:
        if command is None or self._command is None:
            return
        if command.loop != self._command.loop:
            self._turn(command, states)
        self._command = command
        now_s = time.monotonic()
        if command.records and self._figures is not None:
            self._figures.add_frame(now_s, images, any(state.limited & Limited.SPEED for state in states))
            self._figures.lost = _lost(states) - self._lost_before
        if now_s - self._looked_s > _LOOK_S:
            self._looked_s = now_s
            self._look(command, now_s - self._loop_began_s)

    def _look(self, command: RecordCommand, elapsed_s: float) -> None:
        """The status line; and the end of an episode that would fill the disk."""
        options, free = command.options, self._guard.free_bytes()
        if command.records and free < LEFT_FREE:
            logger.warning("the disk of %s is almost full: the recording ends now", command.dataset.root)
            command.stop()
        if command.records and self._figures is not None:
            what = f"episode {self._figures.index} ({self._figures.index - self._first + 1} of {options.num_episodes})"
            left_s, rate = options.episode_time_s - elapsed_s, f"{self._figures.achieved_fps:.1f} fps, "
        else:
            what, left_s, rate = "reset the scene", options.reset_time_s - elapsed_s, ""
        self._status.show(f"{what}: {max(left_s, 0.0):.0f} s left, {rate}{free / 1e9:.0f} GB free")

    def _turn(self, command: RecordCommand, states: Sequence[ArmState]) -> None:
        """LeRobot has left its loop and entered it anew."""
        self._loop_began_s = time.monotonic()
        self._tell()
        if not command.records:  # it resets; the episode before is not saved yet
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
        """Write the figures of the episode before, if LeRobot has saved it."""
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
