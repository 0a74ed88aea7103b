"""Desk that shows a page the state of the LeRobot command in this process, and receives the page's requests.

A separate thread does all work of the desk, a few times per second. Therefore the desk neither slows the command nor
waits while LeRobot saves, and a request is not carried out late, in another phase.
"""

import contextlib
import logging
import shutil
import threading
import time
from collections import deque
from collections.abc import Mapping
from typing import Any

from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.face.lerobot_command.running_command import (
    EVALUATION,
    Meaning,
    Phase,
    Situation,
    command_above,
    evaluation_values,
    look,
)
from lerobot_robot_yam.face.operator_keys import requests
from lerobot_robot_yam.face.operator_keys.operator_keys import OperatorKeys
from lerobot_robot_yam.face.operator_keys.requests import Press
from lerobot_robot_yam.face.recorder.disk_guard import DiskLeft, disk_warning
from lerobot_robot_yam.state.desk_post import Asked, DeskPost
from lerobot_robot_yam.system.runtime_files import runtime_dir

logger = logging.getLogger(__name__)

_LIVE = (Phase.RECORDING, Phase.AUTONOMOUS, Phase.CORRECTING)  # phases in which a data set may grow
_LATE = 1.5  # number of periods after which a tick counts as late, as in `EpisodeFigures`
_RECENT_S = 5.0  # time over which the rate is computed, s
_KEPT = 4096  # maximum number of ticks that wait to be counted
_TOLD_S = 0.5  # interval between status reports to the page, s
_WAIT_S = 0.25  # maximum wait for requests, s
_PAUSE_S = 0.05  # pause between two batches of requests, s
_COMPLAIN_S = 10.0  # minimum time between two warnings about malformed requests, s
_END_S = 2.0  # timeout of joining the thread, s


class TickPace:
    """Counter of the real rate of a command's loop. Each run of the loop is counted anew.

    The loop only stores the time, in `tick`; another thread counts.
    """

    def __init__(self) -> None:
        self._new = deque[float](maxlen=_KEPT)
        self._recent = deque[float]()
        self._run: float | None = None
        self._late = 0

    def tick(self) -> None:
        """Store the time of an observation by the loop."""
        self._new.append(time.perf_counter())

    def count(self, run: float, began_s: float, fps: float) -> tuple[float | None, int]:
        """Return the ticks per second over the last 5 s, and the number of late ticks in this run of the loop.

        Args:
            run: number that distinguishes this run of the loop from the previous run.
            began_s: start of the run, on `time.perf_counter`.
            fps: ticks per second that the command requests.

        Returns:
            The rate, 1/s, None before the second tick; and the number of late ticks.
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
    """Status of one command.

    Args:
        name: the command, such as lerobot-record.
        config: LeRobot's parsed options.
        pace: counter of the loop's rate.
    """

    def __init__(self, name: str, config: Any, pace: TickPace):
        self.name, self._config, self._pace = name, config, pace
        self._disk = DiskLeft()
        self._first: int | None = None  # number of episodes in the data set before this session

    def look(self) -> dict[str, Any]:
        """Return all known facts, by name, ready for JSON. Unknown facts are omitted."""
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
            rate, late = self._pace.count(known.get("saved", 0), 0.0, fps)  # the loop has no start time
            known |= {"fps": rate, "fps_asked": fps, "late": late}
            known |= {"elapsed_s": values["step"] / fps, "left_s": (values["max_steps"] - values["step"]) / fps}
        return known


def _queues(writer: Any) -> dict[str, Any]:
    """Return the number of frames waiting for LeRobot's encoder, or for the writer of its images."""
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


_one = threading.Lock()  # allows one desk per process: environments of lerobot-eval may have several robots


class SessionDesk:
    """Desk of one robot, from connect to disconnect. Does nothing under other programs, and never raises."""

    def __init__(self) -> None:
        self._pace = TickPace()
        self._ends = threading.Event()
        self._thread: threading.Thread | None = None
        self._post: DeskPost
        self._complained_s = -_COMPLAIN_S
        self._keys = OperatorKeys({}, auto=False, by_request=True)

    def begin(self) -> None:
        """Start the desk, before the arms are energised."""
        try:
            found = command_above()
            if found is None or not _one.acquire(blocking=False):
                return
            try:
                self._post = post = DeskPost(runtime_dir())
            except BaseException:
                _one.release()
                raise
        except (OSError, YamError) as error:
            logger.warning("no page can show this command: %s", error)
            return
        self._keys.start(dict)
        self._ends.clear()
        arguments = post, CommandFacts(*found, self._pace)
        self._thread = threading.Thread(target=self._run, args=arguments, name="session desk", daemon=True)
        self._thread.start()

    def observed(self) -> None:
        self._pace.tick()

    def end(self) -> None:
        thread, self._thread = self._thread, None
        if thread is None:
            return
        self._ends.set()
        self._post.wake()
        thread.join(_END_S)
        try:
            self._keys.stop()
        except Exception as error:
            logger.warning("labels that a page has asked for may be lost: %r", error)
        _one.release()

    def _run(self, post: DeskPost, facts: CommandFacts) -> None:
        told_s = 0.0
        try:
            while not self._ends.is_set():
                asked, malformed = post.asked(_WAIT_S)
                unknown = [one for one in dict.fromkeys(asked) if not self._pass_on(one)]
                if malformed or unknown:
                    self._complain(malformed + len(unknown))
                if asked or malformed:
                    self._ends.wait(_PAUSE_S)
                if time.monotonic() - told_s >= _TOLD_S:
                    told_s = time.monotonic()
                    with contextlib.suppress(OSError):  # such as a full disk; the page shows how old the status is
                        post.tell(facts.look())
        except Exception as error:
            logger.warning("no page shows this command from now on: %r", error)
        finally:
            post.close()

    def _pass_on(self, asked: Asked) -> bool:
        try:
            press = Press(asked.by, Meaning(asked.meaning), asked.turn)
        except ValueError:
            return False
        if not requests.ask(press):
            logger.warning("%s (%s): this command can be asked for nothing", press.by, press.meaning)
        return True

    def _complain(self, count: int) -> None:
        now_s = time.monotonic()
        if now_s - self._complained_s > _COMPLAIN_S:
            self._complained_s = now_s
            logger.warning("ignored %d request%s that nobody understands", count, "s" * (count > 1))
