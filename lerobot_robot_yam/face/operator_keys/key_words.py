"""What each meaning of a button would do now, in words. Pure."""

from lerobot_robot_yam.face.operator_keys.key_plan import Phase, Situation, frames_to_label, single_key, step, wanted
from lerobot_robot_yam.face.operator_keys.meanings import LABELS, Meaning

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
    """Of each meaning that does something now, what that is.

    Args:
        now: what the command does.
        first: episodes of the data set before this session.
        automatic: episodes end by themselves.
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
