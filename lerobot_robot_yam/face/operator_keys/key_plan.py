"""Effect of a button on a LeRobot command, and its description in words. Pure: no clock, no keyboard.

Each press of a LeRobot key brings the command closer to the phase that the button means; only a stop sets flags
(`StopRequest`).
"""

from lerobot_robot_yam.face.lerobot_command.running_command import (
    AGAIN,
    LABELS,
    LEAVE_LOOP,
    STOP,
    Meaning,
    Phase,
    Situation,
)

_STEPS = {  # (current phase, wanted phase) → meaning of the first key on the path
    (Phase.AUTONOMOUS, Phase.PAUSED): Meaning.PAUSE,
    (Phase.AUTONOMOUS, Phase.CORRECTING): Meaning.PAUSE,
    (Phase.PAUSED, Phase.AUTONOMOUS): Meaning.PAUSE,
    (Phase.PAUSED, Phase.CORRECTING): Meaning.CORRECT,
    (Phase.CORRECTING, Phase.PAUSED): Meaning.CORRECT,
    (Phase.CORRECTING, Phase.AUTONOMOUS): Meaning.CORRECT,
}


def wanted(meaning: Meaning, now: Situation) -> Phase | None:
    """Return the phase that a button reaches by several keys, one per phase; None if a single key has its effect."""
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


def step(goal: Phase, now: Situation) -> Meaning | None:
    """Return the key of one step towards a phase; None if the phase is reached, or no key leads to it."""
    key = _STEPS.get((now.phase, goal))
    return key if key in now.keys else None


def single_key(meaning: Meaning, now: Situation) -> Meaning | None:
    """Return the key of a button that leads to no phase; None if the command has no such key, or refuses it now.

    Some keys are refused although LeRobot accepts them: a key between two phases would end an episode without a frame,
    and LeRobot would end the whole recording with an error. So would a key that ends a phase but arrives after its end.
    """
    key = Meaning.NEXT if meaning in LABELS else meaning
    if key not in now.keys:
        return None
    if Meaning.NEXT not in now.keys:
        return key
    if now.phase is Phase.RECORDING:
        return key if now.frames and not (now.ends_by_itself and key is Meaning.NEXT) else None
    if now.phase is Phase.RESETTING:
        return None if meaning in LABELS or now.ends_by_itself else key
    return None


def frames_to_label(now: Situation, automatic: bool) -> int | None:
    """Return the number of frames of the episode to label, 0 if it is already saved; None: no label.

    Args:
        now: the command's situation.
        automatic: whether episodes end by themselves. If so, a discarded recording was never an episode, and the label
            is for the previous episode. Otherwise a person means the episode that was just discarded.
    """
    if now.drops:
        return 0 if automatic else None
    return now.frames


def rescue(now: Situation) -> Meaning | None:
    """Return the key, independent of buttons, that prevents saving an episode without a frame; None if not needed."""
    empty = now.phase is Phase.RESETTING and now.dataset is not None and not now.frames and not now.drops
    return Meaning.RERECORD if empty and Meaning.RERECORD in now.keys else None


class StopRequest:
    """Button press that stops a command which records episode by episode, by setting LeRobot's flags.

    LeRobot's stop key sets two flags at once: stop, and leave the loop. A key takes effect with a delay. If the next
    episode has begun by then, the key ends that episode before its first frame; LeRobot then saves it, and fails.
    Therefore the button sets the same flags itself, one after the other:

        stop       at once: no further episode begins, unless it has already begun
        re-record  if an episode has begun since, or the episode to be saved has no frame: the episode is discarded
        leave      once a loop runs with the flags above set: no episode follows that loop

    now: situation in which the button is pressed.
    """

    def __init__(self, now: Situation):
        self._turn = now.turn if now.phase is Phase.RECORDING and now.frames else None
        now.flags[STOP] = True

    def advance(self, now: Situation) -> bool:
        """Set the flags that are due. Return whether all flags are set."""
        if now.phase not in (Phase.RECORDING, Phase.RESETTING):
            return not now.command
        if now.turn != self._turn if now.phase is Phase.RECORDING else not now.frames:
            now.flags[AGAIN] = True
        now.flags[LEAVE_LOOP] = True
        return True


def refusal(meaning: Meaning, button: str, now: Situation) -> str:
    """Return the reason why a button that is not a label has no effect now."""
    what = f"button {button} ({meaning})"
    if not now.command:
        return f"{what}: LeRobot does not listen to keys now"
    if (Meaning.CORRECT if meaning is Meaning.GO_ON else meaning) not in now.keys:
        return f"{what}: means nothing to {now.command}"
    ends = ", which ends by itself in a moment" if now.ends_by_itself else ""
    return f"{what}: not now, {now.command} is {now.phase.value}{ends}"


_WORDS = {
    Meaning.PAUSE: "pauses the policy; once more: it goes on",
    Meaning.CORRECT: "takes over from the policy; once more: ends the correction",
    Meaning.GO_ON: "gives the arms back to the policy",
    Meaning.SAVE: "keeps what was seen last, and what comes; once more: ends it",
    Meaning.UPLOAD: "uploads the data set",
    Meaning.STOP: "ends the command",
}
_OF_EPISODES = {
    (Meaning.NEXT, Phase.RECORDING): "ends episode {episode}",
    (Meaning.NEXT, Phase.RESETTING): "ends the reset, and saves episode {episode}",
    (Meaning.RERECORD, Phase.RECORDING): "drops episode {episode}, and records it again after a reset",
    (Meaning.RERECORD, Phase.RESETTING): "drops episode {episode}, and records it again now",
    (Meaning.STOP, Phase.RECORDING): "ends and saves episode {episode}, then the command",
    (Meaning.STOP, Phase.RESETTING): "saves episode {episode}, then ends the command",
}
_DROPPED = {
    Meaning.NEXT: "ends the reset, and records episode {episode} again",
    Meaning.RERECORD: "ends the reset, and records episode {episode} again",
    Meaning.STOP: "ends the command; episode {episode} is dropped",
}


def offers(now: Situation, first: int, automatic: bool) -> dict[str, str]:
    """Return meaning → description of its current effect. Meanings without an effect are omitted.

    Args:
        now: the command's situation.
        first: number of episodes in the data set before this session.
        automatic: whether episodes end by themselves.
    """
    found = {}
    for meaning in Meaning:
        words = _label(meaning, now, first, automatic) if meaning in LABELS else _key(meaning, now)
        if words:
            found[meaning.value] = words
    return found


def _key(meaning: Meaning, now: Situation) -> str:
    goal = wanted(meaning, now)
    stops = meaning is Meaning.STOP and now.flags
    does = single_key(meaning, now) is not None if goal is None else step(goal, now) is not None
    if not (does or stops):
        return ""
    if now.drops and meaning in _DROPPED:
        return _DROPPED[meaning].format(episode=_count(now))
    return _OF_EPISODES.get((meaning, now.phase), _WORDS.get(meaning, "")).format(episode=_count(now))


def _label(meaning: Meaning, now: Situation, first: int, automatic: bool) -> str:
    frames = frames_to_label(now, automatic)
    if now.dataset is None or frames is None:
        return ""
    if not frames:
        return f"labels episode {_count(now) - 1}" if _count(now) > first else ""
    ends = single_key(meaning, now) is not None or now.phase is Phase.CORRECTING
    return f"labels episode {_count(now)}{', and ends it' if ends else ''}"


def _count(now: Situation) -> int:
    return now.dataset.num_episodes if now.dataset is not None else 0
