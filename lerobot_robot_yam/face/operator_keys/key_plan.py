"""Which of LeRobot's keys brings a command closer to what a button means. Pure: no clock, no keyboard."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from lerobot_robot_yam.face.operator_keys.meanings import LABELS, Meaning

RECORD = "lerobot-record"
_KEY_S = 0.2  # a key is on its way for about 0.03 s, and is answered at the next frame


class Phase(Enum):
    """What a LeRobot command does."""

    BETWEEN = "between two phases"  # it connects, saves, ends
    RECORDING = "recording"
    RESETTING = "resetting"
    AUTONOMOUS = "autonomous"  # the policy drives
    PAUSED = "paused"
    CORRECTING = "correcting"


@dataclass(frozen=True)
class Situation:
    """A look at a LeRobot command.

    Attributes:
        command: what messages call it, empty without one.
        phase: what it does.
        keys: of what it can be asked for by key, the key, as LeRobot's listeners call it.
        dataset: LeRobot's data set that it writes, once there is one.
        turn: tells one run of its loop from another.
        drops: the episode before is dropped, not saved, when the reset ends.
        left_s: until the phase ends by itself.
        flags: of a command that records episode by episode, LeRobot's own, which its keys set.
        do: what LeRobot's listener does at one of these keys.
        listens: False: it has no listener; its keys are ours, and `do` is the only way.
    """

    command: str = ""
    phase: Phase = Phase.BETWEEN
    keys: Mapping[Meaning, str] = field(default_factory=dict)
    dataset: Any = None
    turn: float = 0.0
    drops: bool = False
    left_s: float = math.inf
    flags: dict[str, Any] = field(default_factory=dict)
    do: Callable[[str], None] = lambda key: None
    listens: bool = True

    @property
    def frames(self) -> int:
        """Frames of the episode that is not saved yet."""
        writer = self.dataset.writer if self.dataset is not None else None
        buffer = writer.episode_buffer if writer is not None else None
        return int(buffer.get("size", 1)) if buffer is not None else 0  # LeRobot takes the count away while it saves

    @property
    def ends_by_itself(self) -> bool:
        """It ends so soon that a key would end what comes next, perhaps an episode that has no frame yet."""
        return self.left_s < _KEY_S


_STEPS = {  # from → to: what to press first
    (Phase.AUTONOMOUS, Phase.PAUSED): Meaning.PAUSE,
    (Phase.AUTONOMOUS, Phase.CORRECTING): Meaning.PAUSE,
    (Phase.PAUSED, Phase.AUTONOMOUS): Meaning.PAUSE,
    (Phase.PAUSED, Phase.CORRECTING): Meaning.CORRECT,
    (Phase.CORRECTING, Phase.PAUSED): Meaning.CORRECT,
    (Phase.CORRECTING, Phase.AUTONOMOUS): Meaning.CORRECT,
}


def wanted(meaning: Meaning, now: Situation) -> Phase | None:
    """The phase that a button asks for, where keys lead from phase to phase; None: a single key does it."""
    if Meaning.CORRECT not in now.keys:
        return None
    if meaning is Meaning.PAUSE:
        return Phase.AUTONOMOUS if now.phase is Phase.PAUSED else Phase.PAUSED
    if meaning is Meaning.CORRECT:
        return Phase.PAUSED if now.phase is Phase.CORRECTING else Phase.CORRECTING
    if meaning is Meaning.GO_ON:
        return Phase.AUTONOMOUS
    if meaning in LABELS and now.phase is Phase.CORRECTING:
        return Phase.PAUSED
    return None


def step(goal: Phase, now: Situation) -> str | None:
    """The key that leads one step towards a phase; None: it is reached, or no key leads there from here."""
    meaning = _STEPS.get((now.phase, goal))
    return None if meaning is None else now.keys.get(meaning)


def single_key(meaning: Meaning, now: Situation) -> str | None:
    """The key of a button that asks for no phase; None: the command has none for it, or not now.

    Some are refused although LeRobot would take them: between two phases they would end an episode that has no frame
    yet, which ends the whole recording with an error. So would a key that ends a phase, if it came after its end.
    """
    key = now.keys.get(Meaning.NEXT if meaning in LABELS else meaning)
    if Meaning.NEXT not in now.keys:
        return None if meaning in LABELS else key
    if now.phase is Phase.RECORDING:
        late = now.ends_by_itself and key == now.keys[Meaning.NEXT]
        return key if now.frames and not late else None
    if now.phase is Phase.RESETTING:
        return None if meaning in LABELS or now.ends_by_itself else key
    return None


def frames_to_label(now: Situation, automatic: bool) -> int | None:
    """Frames of the episode that a label is for, 0: it is saved already; None: a label would be for a wrong one.

    Args:
        now: what the command does.
        automatic: episodes end by themselves. Then what is dropped was never an episode, and the label is for the one
            before. Else somebody means the episode that he has just dropped.
    """
    if now.drops:
        return 0 if automatic else None
    return now.frames


def rescue(now: Situation) -> str | None:
    """The key that is needed whatever was pressed: an episode without a frame is not saved, but recorded again."""
    empty = now.phase is Phase.RESETTING and now.dataset is not None and not now.frames and not now.drops
    return now.keys.get(Meaning.RERECORD) if empty else None


def refusal(meaning: Meaning, button: str, now: Situation) -> str:
    """Why a button that is no label does nothing now."""
    what = f"button {button} ({meaning})"
    if not now.command:
        return f"{what}: LeRobot does not listen to keys now"
    if (Meaning.CORRECT if meaning is Meaning.GO_ON else meaning) not in now.keys:
        return f"{what}: means nothing to {now.command}"
    ends = ", which ends by itself in a moment" if now.ends_by_itself else ""
    return f"{what}: not now, {now.command} is {now.phase.value}{ends}"
