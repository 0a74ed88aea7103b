"""The LeRobot command that runs in this process and listens to keys: what it does at the moment, and its keys.

Like `record_command`, this reads LeRobot's own variables from the stack of the main thread.
"""

import math
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from types import FrameType
from typing import Any

from lerobot_robot_yam.face.operator_keys.key_plan import RECORD, Phase, Situation
from lerobot_robot_yam.face.operator_keys.meanings import Meaning
from lerobot_robot_yam.face.recorder.record_command import AGAIN, PACKAGE, callers, running_record

_LISTENING = tuple(str(PACKAGE / "scripts" / f"lerobot_{name}.py") for name in ("record", "rollout"))
_STRATEGIES = f"{PACKAGE / 'rollout' / 'strategies'}/"
_RUN = "run"  # the method of a strategy in which it runs
_BEGAN = "start_time"  # its variable, of strategies without episodes
_EPISODE_KEYS = {Meaning.NEXT: "right", Meaning.RERECORD: "left"}
_EPISODE_LOOPS = {"_policy_loop": Phase.RECORDING, "_reset_loop": Phase.RESETTING}


def hears_keys(frame: FrameType | None) -> bool:
    """Whether a command that listens to keys has called down to `frame`: two of LeRobot's do."""
    return any(caller.f_code.co_filename in _LISTENING for caller in callers(frame))


def look() -> Situation:
    """What the command does now. Any thread may ask."""
    frame = sys._current_frames().get(threading.main_thread().ident or 0)
    command = running_record(frame)
    if command is None:
        return _rollout(frame)
    phase = Phase.BETWEEN
    if command.loop is not None:
        phase = Phase.RECORDING if command.records else Phase.RESETTING
    keys = _EPISODE_KEYS if command.events else {}  # before, it does not listen yet
    left_s, turn, flags = command.ends - time.perf_counter(), command.loop or 0.0, command.events
    return Situation(RECORD, phase, keys, command.dataset, turn, command.drops, left_s, flags, _by_flags(flags))


def _by_flags(flags: dict[str, Any]) -> Callable[[str], None]:
    """What the listener of a command that records episode by episode does at a key."""
    from lerobot.utils.keyboard_input import apply_recording_control

    return lambda key: apply_recording_control(key, flags)


def _rollout(frame: FrameType | None) -> Situation:
    loop, turn, left_s = Phase.BETWEEN, 0.0, math.inf
    for caller in callers(frame):
        if not caller.f_code.co_filename.startswith(_STRATEGIES):
            continue
        name, values = caller.f_code.co_name, caller.f_locals
        turn = turn or values.get(_BEGAN, 0.0)
        if name in _EPISODE_LOOPS:
            turn = values.get("start_t", 0.0)
            loop = _EPISODE_LOOPS[name] if turn else Phase.BETWEEN
            left_s = turn + values["control_time_s"] - time.perf_counter() if turn else math.inf
        elif name == _RUN and "ctx" in values:
            return _strategy(values["self"], values["ctx"], loop, turn, left_s)
    return Situation()


def _strategy(strategy: Any, ctx: Any, loop: Phase, turn: float, left_s: float) -> Situation:
    kind, options, dataset, stop = strategy.config.type, strategy.config, ctx.data.dataset, ctx.runtime.shutdown_event
    command = f"the {kind} strategy of lerobot-rollout"
    if kind == "episodic":
        flags, do = strategy._events, _by_flags(strategy._events)
        return Situation(command, loop, _EPISODE_KEYS, dataset, turn, bool(flags.get(AGAIN)), left_s, flags, do)
    stopped = {Meaning.STOP: "esc"}
    if kind == "dagger" and options.input_device == "keyboard":
        named, events = options.keyboard, strategy._events
        keys = {Meaning.PAUSE: named.pause_resume, Meaning.CORRECT: named.correction, Meaning.UPLOAD: named.upload}
        does = {
            named.pause_resume: partial(events.request_transition, "pause_resume"),
            named.correction: partial(events.request_transition, "correction"),
            named.upload: events.upload_requested.set,
            "esc": events.stop_recording.set,
        }
        phase = Phase(events.phase.value)
        return Situation(command, phase, {**keys, **stopped}, dataset, turn, do=lambda key: does[key]())
    if kind == "highlight":
        keys = {Meaning.SAVE: options.save_key, Meaning.UPLOAD: options.push_key, **stopped}
        does = {
            options.save_key: strategy._save_requested.set,
            options.push_key: strategy._push_requested.set,
            "esc": stop.set,
        }
        return Situation(command, Phase.AUTONOMOUS, keys, dataset, turn, do=lambda key: does[key]())
    return Situation(command, Phase.AUTONOMOUS, stopped, dataset, turn, do=lambda key: stop.set())
