"""What can be known of the LeRobot command in this process, for a page beside it: by its own objects, and its pace."""

import shutil
import time
from collections import deque
from collections.abc import Mapping
from typing import Any

from lerobot_robot_yam.face.lerobot_command.running_command import (
    EVALUATION,
    Phase,
    Situation,
    evaluation_values,
    look,
)
from lerobot_robot_yam.face.operator_keys import requests
from lerobot_robot_yam.face.recorder.disk_guard import DiskLeft, disk_warning

_LIVE = (Phase.RECORDING, Phase.AUTONOMOUS, Phase.CORRECTING)  # a data set may grow
_LATE = 1.5  # of a tick's time, as `EpisodeFigures` counts
_RECENT_S = 5.0  # whose ticks make a rate
_KEPT = 4096  # times that nobody has counted yet


class TickPace:
    """Counter of how fast a command's loop really runs, one loop after the other.

    The loop itself only notes the time, in `tick`; another thread counts.
    """

    def __init__(self) -> None:
        self._new = deque[float](maxlen=_KEPT)
        self._recent = deque[float]()
        self._run: float | None = None
        self._late = 0

    def tick(self) -> None:
        """The loop has observed, just now."""
        self._new.append(time.perf_counter())

    def count(self, run: float, began_s: float, fps: float) -> tuple[float | None, int]:
        """Ticks per second, of the last 5 s, and how many ticks of this run of the loop came late.

        Args:
            run: tells it from the one before.
            began_s: when it began, on `time.perf_counter`.
            fps: ticks per second that are asked for.

        Returns:
            None in the place of the rate, before there are two ticks.
        """
        if run != self._run:
            self._run, self._late = run, 0
            self._recent.clear()
        while self._new:
            at_s = self._new.popleft()
            if at_s >= began_s:
                self._late += bool(self._recent) and at_s - self._recent[-1] > _LATE / fps
                self._recent.append(at_s)
        while len(self._recent) > 1 and self._recent[-1] - self._recent[0] > _RECENT_S:
            self._recent.popleft()
        if len(self._recent) < 2:
            return None, self._late
        return (len(self._recent) - 1) / (self._recent[-1] - self._recent[0]), self._late


class CommandFacts:
    """Facts about one command.

    Args:
        name: what it is called, such as lerobot-record.
        config: LeRobot's, as it has parsed its options.
        pace: counts how fast its loop runs.
    """

    def __init__(self, name: str, config: Any, pace: TickPace):
        self.name, self._config, self._pace = name, config, pace
        self._disk = DiskLeft()
        self._first: int | None = None  # episodes of the data set before this session

    def look(self) -> dict[str, Any]:
        """All that is known now, ready for JSON; what cannot be known is not in it."""
        if self.name == EVALUATION:
            known = self._evaluation()
        else:
            now = look()
            known = {**self._situation(now), **self._data(now)}
        return {name: value for name, value in known.items() if value not in (None, "", {})}

    def _situation(self, now: Situation) -> dict[str, Any]:
        config, dataset = self._config, self._config.dataset
        if now.dataset is not None and self._first is None:
            self._first = now.dataset.num_episodes
        fps = getattr(config, "fps", 0) * getattr(config, "interpolation_multiplier", 1) or dataset.fps
        rate, late = self._pace.count(now.turn, now.turn, fps) if now.turn else (None, None)
        elapsed_s = time.perf_counter() - now.turn if now.turn else None
        duration_s, left_s = getattr(config, "duration", 0), now.left_s if now.left_s != float("inf") else None
        if left_s is None and duration_s and elapsed_s is not None:
            left_s = duration_s - elapsed_s
        by_episodes = bool(now.flags)
        return {
            "command": self.name,
            "strategy": getattr(getattr(config, "strategy", None), "type", None),
            "task": getattr(dataset, "single_task", None) or getattr(config, "task", None),
            "phase": now.phase.value if now.command else None,
            "turn": now.turn,
            "drops": now.drops or None,
            "episodes": dataset.num_episodes if by_episodes else None,
            "elapsed_s": elapsed_s,
            "left_s": None if left_s is None else max(left_s, 0.0),
            "fps": rate,
            "fps_asked": fps,
            "late": late,
            "offers": requests.offers(now, self._first or 0),
        }

    def _data(self, now: Situation) -> dict[str, Any]:
        dataset = now.dataset
        if dataset is None:
            return {}
        free = shutil.disk_usage(dataset.root).free
        left_s = self._disk.left_s(time.monotonic(), free, now.phase in _LIVE)
        return {
            "root": str(dataset.root),
            "saved": dataset.num_episodes,
            "first": self._first,
            "frames": now.frames,
            "disk_free_bytes": free,
            "disk_left_s": left_s,
            "disk_warning": disk_warning(left_s, free),
            **_queues(dataset.writer),
        }

    def _evaluation(self) -> dict[str, Any]:
        config, values = self._config, evaluation_values()
        known = {
            "command": self.name,
            "task": getattr(config.env, "description", None) or config.env.task,
            "phase": Phase.AUTONOMOUS.value if "step" in values else Phase.BETWEEN.value,
            "episodes": values.get("n_episodes"),
            "offers": requests.offers(Situation(), 0),
        }
        done = values.get("all_successes")
        if done is not None:
            known |= {"saved": len(done), "first": 0, "successes": sum(map(bool, done))}
        fps = config.env.fps
        if "step" in values and fps:
            rate, late = self._pace.count(known.get("saved", 0), 0.0, fps)  # its loop does not say when it began
            known |= {"fps": rate, "fps_asked": fps, "late": late}
            known |= {"elapsed_s": values["step"] / fps, "left_s": (values["max_steps"] - values["step"]) / fps}
        return known


def _queues(writer: Any) -> dict[str, Any]:
    """Frames that wait for LeRobot's encoder, or for the writer of its images."""
    found: dict[str, Any] = {}
    encoder = getattr(writer, "_streaming_encoder", None)
    queues: Mapping[str, Any] = getattr(encoder, "_frame_queues", None) or {}
    if queues:
        found["encoder_waiting"] = {name: queue.qsize() for name, queue in dict(queues).items()}
        found["encoder_room"] = getattr(encoder, "queue_maxsize", None)
        found["encoder_lost"] = dict(getattr(encoder, "_dropped_frames", None) or {})
    images = getattr(getattr(writer, "image_writer", None), "queue", None)
    if images is not None:
        found["images_waiting"] = images.qsize()
    return found
