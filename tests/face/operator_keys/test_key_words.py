"""What is said of a key is what it does."""

import itertools
import math

import pytest

from lerobot_robot_yam.face.operator_keys.key_plan import Phase, Situation, single_key, step, wanted
from lerobot_robot_yam.face.operator_keys.key_words import offers
from lerobot_robot_yam.face.operator_keys.meanings import LABELS, Meaning
from tests.face.operator_keys.test_key_plan import DAGGER, EPISODES, HIGHLIGHT, Dataset


class Numbered(Dataset):
    def __init__(self, frames, count):
        super().__init__(frames)
        self.num_episodes = count


def recording(phase, frames=9, count=3, drops=False, left_s=math.inf):
    return Situation(
        "lerobot-record", phase, EPISODES, Numbered(frames, count), 1.0, drops, left_s, {"exit_early": False}
    )


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
        now = Situation("a strategy", phase, keys, Numbered(0, 0))
        goal = wanted(meaning, now)
        does = single_key(meaning, now) if goal is None else step(goal, now)
        assert (meaning in offers(now, 0, automatic=False)) == (does is not None)


def test_without_a_command_nothing_is_offered():
    assert offers(Situation(), 0, automatic=False) == {}
