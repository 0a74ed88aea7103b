"""Which key a button presses in which situation, and what is said of it."""

import itertools
import math

import pytest

from lerobot_robot_yam.face.lerobot_command.running_command import AGAIN, LABELS, Meaning, Phase, Situation
from lerobot_robot_yam.face.operator_keys.key_plan import (
    frames_to_label,
    offers,
    refusal,
    rescue,
    single_key,
    step,
    wanted,
)

EPISODES = dict.fromkeys((Meaning.NEXT, Meaning.RERECORD))
DAGGER = dict.fromkeys((Meaning.PAUSE, Meaning.CORRECT, Meaning.UPLOAD, Meaning.STOP))
HIGHLIGHT = dict.fromkeys((Meaning.SAVE, Meaning.UPLOAD, Meaning.STOP))
POLICY_PHASES = (Phase.AUTONOMOUS, Phase.PAUSED, Phase.CORRECTING)


class Dataset:
    """As much of a data set as a situation looks at."""

    def __init__(self, frames, count=0):
        self.writer, self.episode_buffer, self.num_episodes = self, {"size": frames}, count


def situation(phase, keys=EPISODES, frames=9, drops=False, **more):
    return Situation("lerobot-record", phase, keys, Dataset(frames), flags={AGAIN: drops}, **more)


ROWS = [
    (Phase.RECORDING, Meaning.NEXT, Meaning.NEXT),
    (Phase.RECORDING, Meaning.RERECORD, Meaning.RERECORD),
    (Phase.RECORDING, Meaning.FAILURE, Meaning.NEXT),
    (Phase.RESETTING, Meaning.NEXT, Meaning.NEXT),
    (Phase.RESETTING, Meaning.RERECORD, Meaning.RERECORD),
    (Phase.RESETTING, Meaning.SUCCESS, None),
    (Phase.BETWEEN, Meaning.NEXT, None),
    (Phase.BETWEEN, Meaning.RERECORD, None),
    (Phase.RECORDING, Meaning.SAVE, None),
]


@pytest.mark.parametrize(("phase", "meaning", "key"), ROWS)
def test_a_recording(phase, meaning, key):
    assert single_key(meaning, situation(phase)) == key
    assert wanted(meaning, situation(phase)) is None


@pytest.mark.parametrize("meaning", [Meaning.NEXT, Meaning.DISCARD])
def test_an_episode_without_a_frame_is_not_ended(meaning):
    """LeRobot would end the whole recording with an error."""
    assert single_key(meaning, situation(Phase.RECORDING, frames=0)) is None


LATE_ROWS = [
    (Phase.RECORDING, Meaning.NEXT, None),
    (Phase.RECORDING, Meaning.FAILURE, None),
    (Phase.RECORDING, Meaning.RERECORD, Meaning.RERECORD),
    (Phase.RESETTING, Meaning.NEXT, None),
    (Phase.RESETTING, Meaning.RERECORD, None),
]


@pytest.mark.parametrize(("phase", "meaning", "key"), LATE_ROWS)
def test_a_phase_that_ends_by_itself_is_not_ended_by_a_key(phase, meaning, key):
    """The key would end the next episode."""
    now = situation(phase, left_s=0.1)
    assert single_key(meaning, now) == key
    assert single_key(meaning, situation(phase, left_s=0.5)) is not None
    assert key is not None or meaning in LABELS or "ends by itself" in refusal(meaning, "left_top", now)


def test_an_episode_that_a_late_key_has_ended_without_a_frame_is_recorded_again():
    assert rescue(situation(Phase.RESETTING, frames=0)) == Meaning.RERECORD
    assert rescue(situation(Phase.RESETTING, frames=0, drops=True)) is None
    assert rescue(situation(Phase.RESETTING, frames=1)) is None
    assert rescue(situation(Phase.RECORDING, frames=0)) is None
    assert rescue(Situation("", Phase.RESETTING, EPISODES)) is None


def test_a_label_behind_rerecord_is_not_for_the_good_episode_before():
    dropped = situation(Phase.RESETTING, drops=True)
    assert frames_to_label(dropped, automatic=False) is None
    assert frames_to_label(dropped, automatic=True) == 0
    assert frames_to_label(situation(Phase.RESETTING), automatic=False) == 9


def keys_pressed(meaning, phase):
    """What a policy's rollout goes through, and the keys that lead there."""
    goal, keys = wanted(meaning, situation(phase, DAGGER)), []
    while key := step(goal, situation(phase, DAGGER)):
        keys.append(key)
        if key is Meaning.PAUSE:
            phase = {Phase.AUTONOMOUS: Phase.PAUSED, Phase.PAUSED: Phase.AUTONOMOUS}[phase]
        else:
            phase = {Phase.PAUSED: Phase.CORRECTING, Phase.CORRECTING: Phase.PAUSED}[phase]
        assert len(keys) < 4
    assert phase is goal
    return keys


DAGGER_ROWS = [
    (Phase.AUTONOMOUS, Meaning.PAUSE, [Meaning.PAUSE]),
    (Phase.PAUSED, Meaning.PAUSE, [Meaning.PAUSE]),
    (Phase.CORRECTING, Meaning.PAUSE, [Meaning.CORRECT]),
    (Phase.AUTONOMOUS, Meaning.CORRECT, [Meaning.PAUSE, Meaning.CORRECT]),
    (Phase.PAUSED, Meaning.CORRECT, [Meaning.CORRECT]),
    (Phase.CORRECTING, Meaning.CORRECT, [Meaning.CORRECT]),
    (Phase.AUTONOMOUS, Meaning.GO_ON, []),
    (Phase.PAUSED, Meaning.GO_ON, [Meaning.PAUSE]),
    (Phase.CORRECTING, Meaning.GO_ON, [Meaning.CORRECT, Meaning.PAUSE]),
    (Phase.CORRECTING, Meaning.FAILURE, [Meaning.CORRECT]),
]


@pytest.mark.parametrize(("phase", "meaning", "keys"), DAGGER_ROWS)
def test_a_correction(phase, meaning, keys):
    assert keys_pressed(meaning, phase) == keys


@pytest.mark.parametrize("phase", POLICY_PHASES)
def test_single_keys_of_rollouts(phase):
    for keys in (DAGGER, HIGHLIGHT):
        assert [key for key in Meaning if single_key(key, situation(phase, keys)) is key] == [
            *sorted(keys, key=[*Meaning].index)
        ]
        assert not any(single_key(meaning, situation(phase, keys)) for meaning in LABELS)


@pytest.mark.parametrize(("meaning", "keys"), list(itertools.product(Meaning, (EPISODES, DAGGER, HIGHLIGHT, {}))))
def test_a_button_that_does_nothing_says_why(meaning, keys):
    now = situation(Phase.BETWEEN, keys)
    if meaning in LABELS or wanted(meaning, now) or single_key(meaning, now):
        return
    assert refusal(meaning, "left_top", now).startswith(f"button left_top ({meaning}): ")


def recording(phase, frames=9, count=3, drops=False, left_s=math.inf):
    return Situation("lerobot-record", phase, EPISODES, Dataset(frames, count), 1.0, left_s, {AGAIN: drops})


def test_while_an_episode_is_recorded():
    words = offers(recording(Phase.RECORDING), 0, automatic=False)
    assert set(words) == {"next", "rerecord", "stop", *LABELS}
    assert words["next"] == "ends episode 3" and words["success"] == "labels episode 3, and ends it"


def test_in_the_reset_labels_end_nothing():
    words = offers(recording(Phase.RESETTING), 0, automatic=False)
    assert words["next"] == "ends the reset, and saves episode 3" and words["success"] == "labels episode 3"


def test_a_dropped_episode_has_no_label():
    now = recording(Phase.RESETTING, drops=True)
    words = offers(now, 0, automatic=False)
    assert not set(LABELS) & set(words) and words["next"] == "ends the reset, and records episode 3 again"
    assert offers(now, 0, automatic=True)["failure"] == "labels episode 2"  # what is dropped there was never one
    assert "failure" not in offers(now, 3, automatic=True)  # and that one is an earlier session's


def test_before_the_first_episode_there_is_only_the_end():
    assert set(offers(recording(Phase.BETWEEN, frames=0), 3, automatic=False)) == {"stop"}


@pytest.mark.parametrize("keys", [DAGGER, HIGHLIGHT, {}], ids=["dagger", "highlight", "no keys"])
def test_a_strategy_offers_what_its_keys_do(keys):
    for phase, meaning in itertools.product(Phase, set(Meaning) - set(LABELS)):
        now = Situation("a strategy", phase, keys, Dataset(0, 0))
        goal = wanted(meaning, now)
        does = single_key(meaning, now) if goal is None else step(goal, now)
        assert (meaning in offers(now, 0, automatic=False)) == (does is not None)


def test_without_a_command_nothing_is_offered():
    assert offers(Situation(), 0, automatic=False) == {}
