"""The `lerobot-record` that runs in this process: its data set, its flags, and whether it records at the moment.

LeRobot tells none of this to a robot. It is read from the stack, where LeRobot's own functions keep it; nothing of
LeRobot is replaced. Under every other command there is nothing to find, and nothing happens.
"""

import functools
import importlib.util
import inspect
import json
import logging
import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the command has loaded it, other commands need not
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

logger = logging.getLogger(__name__)

_COMMAND, _LOOP = "record", "record_loop"  # functions of lerobot_record.py
STOP, LEAVE_LOOP, AGAIN = "stop_recording", "exit_early", "rerecord_episode"  # its flags, which its keys set
INFO = Path("meta", "info.json")
_RECORDED = ("*.parquet", "*.mp4", "*.png")


def _lerobot() -> Path:
    spec = importlib.util.find_spec("lerobot")
    return Path((spec and spec.submodule_search_locations or ["/nowhere"])[0])


PACKAGE = _lerobot()
_FILE = str(PACKAGE / "scripts" / "lerobot_record.py")
_COMMANDS = tuple(f"{PACKAGE / folder}/" for folder in ("scripts", "rollout"))


def callers(frame: FrameType | None) -> Iterator[FrameType]:
    """A frame, and those that have called down to it."""
    while frame is not None:
        yield frame
        frame = frame.f_back


def under_a_command(frame: FrameType | None) -> bool:
    """Whether a LeRobot command, not a program of the user's, has called down to `frame`."""
    return any(caller.f_code.co_filename.startswith(_COMMANDS) for caller in callers(frame))


def plays_sounds(frame: FrameType | None) -> bool:
    """Whether the command that has called down to `frame` says aloud what it does: by its option `play_sounds`."""
    configs = (c.f_locals.get("cfg") for c in callers(frame) if c.f_code.co_filename.startswith(_COMMANDS))
    return any(getattr(config, "play_sounds", False) for config in configs)


@dataclass(frozen=True)
class RecordCommand:
    """What the command holds.

    Attributes:
        dataset: the data set that it records.
        options: of its `--dataset`, as LeRobot has parsed them.
        resumes: the data set was there before.
        events: its flags, as its keys set them; empty before it has connected.
        loop: when the present run of its loop began, None outside.
        ends: when that run ends by itself, on `time.perf_counter`.
        records: an episode is being recorded. Else it resets, saves, or has not begun.
    """

    dataset: "LeRobotDataset"
    options: Any
    resumes: bool
    events: dict[str, Any]
    loop: float | None
    ends: float
    records: bool

    def stop(self) -> None:
        """End it as its stop key does: an episode that is being recorded, or was, is saved."""
        self.events[STOP] = self.events[LEAVE_LOOP] = True

    @property
    def drops(self) -> bool:
        """The episode that was recorded last is dropped when the reset ends."""
        return bool(self.events.get(AGAIN))

    def discard(self) -> None:
        """Drop the episode that is being recorded, as its re-record key does."""
        self.events[AGAIN] = self.events[LEAVE_LOOP] = True


def running_record(frame: FrameType | None) -> RecordCommand | None:
    """The command that has called down to `frame`; None under any other, and before its data set is open."""
    loop, ends, records = None, math.inf, False
    for caller in callers(frame):
        if caller.f_code.co_filename != _FILE:
            continue
        name, values = caller.f_code.co_name, caller.f_locals
        if name == _LOOP:
            loop, records = values.get("start_episode_t"), values.get("dataset") is not None
            ends = math.inf if loop is None else loop + values["control_time_s"]
        elif name == _COMMAND:
            dataset, options = values.get("dataset"), values.get("cfg")
            if dataset is None or options is None:
                return None
            events = values.get("events") or {}
            return RecordCommand(dataset, options.dataset, options.resume, events, loop, ends, records)
    return None


def _unsaved(dataset: "LeRobotDataset") -> bool:
    """Whether there are frames that are not saved yet; LeRobot takes their count away while it saves them."""
    buffer = dataset.writer.episode_buffer if dataset.writer is not None else None
    return buffer is not None and buffer.get("size", 1) > 0


class _SaveThenStop:
    """In the place of the stop flag: LeRobot reads it before it resets, and again when it has saved."""

    def __init__(self, dataset: "LeRobotDataset", why: str):
        self._dataset, self._why = dataset, why

    def __bool__(self) -> bool:
        """True while a finished episode is to be saved.

        Raises:
            KeyboardInterrupt: it is saved; the command ends as by Ctrl-C.
        """
        if _unsaved(self._dataset):
            return True
        raise KeyboardInterrupt(self._why)


def stop_after_saving(frame: FrameType | None, why: str) -> bool:
    """Have a signal wait until the episode is saved that is finished, but not saved yet.

    Args:
        frame: where the signal has struck.
        why: what the KeyboardInterrupt says that follows.

    Returns:
        Whether there is such an episode, or one is being saved. If not, nothing was done.
    """
    command = running_record(frame)
    ends_already = sys.exception() is not None  # LeRobot closes the data set: it saves no more
    if command is None or command.records or ends_already or not _unsaved(command.dataset):
        return False
    command.events[STOP], command.events[LEAVE_LOOP] = _SaveThenStop(command.dataset, why), True
    first = "drops the episode" if command.events.get(AGAIN) else "saves the finished episode"
    logger.info("%s: %s first; once more ends it at once", why, first)
    return True


def saves_finished_episode[**P, R](method: Callable[P, R]) -> Callable[P, R]:
    """Decorator of what LeRobot's loop calls: an error while the scene is reset does not cost the episode before."""

    @functools.wraps(method)
    def careful(*arguments: P.args, **options: P.kwargs) -> R:
        try:
            return method(*arguments, **options)
        except Exception:
            _save_finished(inspect.currentframe())
            raise

    return careful


def _save_finished(frame: FrameType | None) -> None:
    command = running_record(frame)
    if command is None or command.loop is None or command.records or command.drops or not _unsaved(command.dataset):
        return
    logger.info("saves the finished episode before it ends with an error")
    try:
        command.dataset.save_episode()
    except Exception as error:
        logger.error("the finished episode cannot be saved: %r", error)


def episodes_in(root: Path) -> int | None:
    """How many episodes the data set in a folder has; None if there is no data set."""
    try:
        return int(json.loads((root / INFO).read_text())["total_episodes"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def is_empty(root: Path) -> bool:
    """Whether a folder is a data set in which nothing was ever recorded: no rows, no images, no videos."""
    return episodes_in(root) == 0 and not any(True for pattern in _RECORDED for _ in root.rglob(pattern))
