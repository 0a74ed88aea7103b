"""LeRobot command that runs in this process: its options, data set, flags, and current phase.

LeRobot passes none of these to a robot. Therefore this module reads them from local variables of LeRobot's functions on
the call stack, without patching LeRobot. Under any other program it finds nothing.
"""

import importlib.util
import inspect
import math
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum, StrEnum
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

RECORD, EVALUATION = "lerobot-record", "lerobot-eval"
STOP, LEAVE_LOOP, AGAIN = "stop_recording", "exit_early", "rerecord_episode"  # LeRobot's flags, which its keys set
_KEY_S = 0.2  # maximum time until a key takes effect, s: keys act at the command's next frame


def _lerobot() -> Path:
    spec = importlib.util.find_spec("lerobot")
    return Path((spec and spec.submodule_search_locations or ["/nowhere"])[0])


_PACKAGE = _lerobot()
_COMMANDS = tuple(f"{_PACKAGE / folder}/" for folder in ("scripts", "rollout"))
_STRATEGIES = f"{_PACKAGE / 'rollout' / 'strategies'}/"
_SCRIPTS = {
    str(_PACKAGE / "scripts" / f"lerobot_{name}.py"): f"lerobot-{name}" for name in ("record", "rollout", "eval")
}
_REPLAY = str(_PACKAGE / "scripts" / "lerobot_replay.py")


class Meaning(StrEnum):
    """Request from a button or a page to a command. See docs/buttons.md."""

    NEXT = "next"  # end the episode, or the reset
    RERECORD = "rerecord"  # discard the episode and record it again
    STOP = "stop"
    SUCCESS = "success"  # label the episode, and end it if it is running
    FAILURE = "failure"
    DISCARD = "discard"
    PAUSE = "pause"  # pause the policy; pressed again: resume the policy
    CORRECT = "correct"  # take over from the policy; pressed again: end the correction
    GO_ON = "go_on"  # give the arms back to the policy
    SAVE = "save"  # keep the last frames and the following ones; pressed again: end the clip
    UPLOAD = "upload"


LABELS = (Meaning.SUCCESS, Meaning.FAILURE, Meaning.DISCARD)


class Phase(Enum):
    BETWEEN = "between two phases"  # the command connects, saves or ends
    RECORDING = "recording"
    RESETTING = "resetting"
    AUTONOMOUS = "autonomous"  # the policy drives
    PAUSED = "paused"
    CORRECTING = "correcting"


_EPISODE_LOOPS = {"_policy_loop": Phase.RECORDING, "_reset_loop": Phase.RESETTING}


@dataclass(frozen=True)
class Situation:
    """State of a LeRobot command at one moment.

    Attributes:
        command: name in messages, empty without a command.
        phase: current phase.
        keys: meaning for which the command has a key → function with the effect of that key.
        dataset: LeRobot's data set that the command writes; None before the command has opened it.
        turn: start time of the current run of the command's loop, on `time.perf_counter`; 0 outside the loop.
        left_s: seconds until the phase ends by itself.
        flags: LeRobot's flags, which its keys set; empty unless the command records episode by episode.
        config: LeRobot's options of the command.
    """

    command: str = ""
    phase: Phase = Phase.BETWEEN
    keys: Mapping[Meaning, Callable[[], object]] = field(default_factory=dict)
    dataset: Any = None
    turn: float = 0.0
    left_s: float = math.inf
    flags: dict[str, Any] = field(default_factory=dict)
    config: Any = None

    @property
    def drops(self) -> bool:
        """Whether the last recorded episode will be discarded instead of saved when the reset ends."""
        return bool(self.flags.get(AGAIN))

    @property
    def frames(self) -> int:
        """Number of frames of the episode that is not saved yet."""
        writer = self.dataset.writer if self.dataset is not None else None
        buffer = writer.episode_buffer if writer is not None else None
        return int(buffer.get("size", 1)) if buffer is not None else 0  # there is no count while LeRobot saves

    @property
    def ends_by_itself(self) -> bool:
        """Whether the phase ends so soon that a key would end the next phase, possibly an episode without a frame."""
        return self.left_s < _KEY_S

    def stop(self) -> None:
        """End the command as its stop key does. The episode that is being recorded, or was just recorded, is saved."""
        self.flags[STOP] = self.flags[LEAVE_LOOP] = True

    def discard(self) -> None:
        """Discard the episode that is being recorded, as the re-record key does."""
        self.flags[AGAIN] = self.flags[LEAVE_LOOP] = True


def callers(frame: FrameType | None = None) -> Iterator[FrameType]:
    """Yield `frame` (default: the current frame), then its caller, and so on."""
    frame = frame or inspect.currentframe()
    while frame is not None:
        yield frame
        frame = frame.f_back


def under_a_command() -> bool:
    """Return whether a LeRobot command, rather than a user's program, is on the call stack."""
    return any(caller.f_code.co_filename.startswith(_COMMANDS) for caller in callers())


def command_above() -> tuple[str, Any] | None:
    """Return name and options of the recording, rollout or evaluation on the call stack, if any."""
    for caller in callers():
        name = _SCRIPTS.get(caller.f_code.co_filename)
        if name is not None and "cfg" in caller.f_locals:
            return name, caller.f_locals["cfg"]
    return None


def hears_keys() -> bool:
    """Return whether a command that listens to keys is on the call stack."""
    found = command_above()
    return found is not None and found[0] != EVALUATION


def _main_frame() -> FrameType | None:
    """Return the frame of the main thread, in which commands run."""
    return sys._current_frames().get(threading.main_thread().ident or 0)


def look() -> Situation:
    """Return the command's current situation. Any thread may call `look`."""
    frame = _main_frame()
    return recording(frame) or _rollout(frame)


def recording(frame: FrameType | None = None) -> Situation | None:
    """Return the situation of the `lerobot-record` on the call stack of `frame`; None before the data set is open.

    frame: default: the frame of the caller.
    """
    phase, turn, left_s = Phase.BETWEEN, 0.0, math.inf
    for caller in callers(frame):
        if _SCRIPTS.get(caller.f_code.co_filename) != RECORD:
            continue
        name, values = caller.f_code.co_name, caller.f_locals
        if name == "record_loop" and "start_episode_t" in values:
            phase = Phase.RESETTING if values.get("dataset") is None else Phase.RECORDING
            turn = values["start_episode_t"]
            left_s = turn + values["control_time_s"] - time.perf_counter()
        elif name == "record":
            dataset, config = values.get("dataset"), values.get("cfg")
            if dataset is None or config is None:
                return None
            flags = values.get("events") or {}  # there is no key listener before the robot has connected
            return Situation(RECORD, phase, _episode_keys(flags), dataset, turn, left_s, flags, config)
    return None


def _episode_keys(flags: dict[str, Any]) -> dict[Meaning, Callable[[], object]]:
    """Return the keys of a command that records episode by episode; empty without LeRobot's flags."""
    from lerobot.utils.keyboard_input import apply_recording_control

    keys = {Meaning.NEXT: "right", Meaning.RERECORD: "left"} if flags else {}
    return {meaning: partial(apply_recording_control, key, flags) for meaning, key in keys.items()}


def _rollout(frame: FrameType | None) -> Situation:
    phase, turn, left_s = Phase.BETWEEN, 0.0, math.inf
    for caller in callers(frame):
        if not caller.f_code.co_filename.startswith(_STRATEGIES):
            continue
        name, values = caller.f_code.co_name, caller.f_locals
        turn = turn or values.get("start_time", 0.0)  # for strategies without episodes
        if name in _EPISODE_LOOPS:
            turn = values.get("start_t", 0.0)
            phase = _EPISODE_LOOPS[name] if turn else Phase.BETWEEN
            left_s = turn + values["control_time_s"] - time.perf_counter() if turn else math.inf
        elif name == "run" and "ctx" in values:
            return _strategy(values["self"], values["ctx"], phase, turn, left_s)
    return Situation()


def _strategy(strategy: Any, ctx: Any, phase: Phase, turn: float, left_s: float) -> Situation:
    kind, options, dataset, stop = strategy.config.type, strategy.config, ctx.data.dataset, ctx.runtime.shutdown_event
    command = f"the {kind} strategy of lerobot-rollout"
    if kind == "episodic":
        flags = strategy._events
        return Situation(command, phase, _episode_keys(flags), dataset, turn, left_s, flags)
    phase, keys = Phase.AUTONOMOUS, {Meaning.STOP: stop.set}
    if kind == "dagger" and options.input_device == "keyboard":
        events = strategy._events
        phase = Phase(events.phase.value)
        keys = {
            Meaning.PAUSE: partial(events.request_transition, "pause_resume"),
            Meaning.CORRECT: partial(events.request_transition, "correction"),
            Meaning.UPLOAD: events.upload_requested.set,
            Meaning.STOP: events.stop_recording.set,
        }
    elif kind == "highlight":
        keys |= {Meaning.SAVE: strategy._save_requested.set, Meaning.UPLOAD: strategy._push_requested.set}
    return Situation(command, phase, keys, dataset, turn)


def replayed_dataset() -> Any:
    """Return the data set of the `lerobot-replay` on the call stack, or None."""
    for caller in callers():
        if caller.f_code.co_filename == _REPLAY and "dataset" in caller.f_locals:
            return caller.f_locals["dataset"]
    return None


def policy_pauses() -> bool:
    """Return whether a rollout with corrections is paused or hands over, and so repeats or fades its last action."""
    for caller in callers():
        if not caller.f_code.co_filename.startswith(_STRATEGIES):
            continue
        if caller.f_code.co_name == "_apply_transition":
            return True
        if caller.f_code.co_name == "run":
            events = getattr(caller.f_locals.get("self"), "_events", None)
            return getattr(getattr(events, "phase", None), "value", None) == Phase.PAUSED.value
    return False


def evaluation_values() -> dict[str, Any]:
    """Return local variables of LeRobot's evaluation in this process, and of its current rollout, by name."""
    found: dict[str, Any] = {}
    for caller in callers(_main_frame()):
        if _SCRIPTS.get(caller.f_code.co_filename) == EVALUATION:
            name, values = caller.f_code.co_name, caller.f_locals
            if name == "rollout" and {"step", "max_steps"} <= values.keys():
                found |= {"step": values["step"], "max_steps": values["max_steps"]}
            elif name == "eval_policy":
                found |= {name: values.get(name) for name in ("n_episodes", "all_successes")}
    return found
