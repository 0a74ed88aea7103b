"""The option `buttons`, and when a button counts as pressed."""

import numpy as np
import pytest

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.lerobot_command.running_command import Meaning
from lerobot_robot_yam.face.operator_keys.handle_buttons import SETS, Presses, RisingEdges, button_meanings
from lerobot_robot_yam.state.arm_state import ArmState
from lerobot_robot_yam.state.records import STATE_DTYPE

TWO = ["left_", "right_"]


@pytest.mark.parametrize("given", [None, "", {}])
def test_off_by_default(given):
    assert button_meanings(given, TWO, {}) == {}


@pytest.mark.parametrize("name", SETS)
@pytest.mark.parametrize("prefixes", [[""], ["left_"], TWO])
def test_every_set_fits_one_arm_and_two(name, prefixes):
    meanings = button_meanings(name, prefixes, {})
    assert len(meanings) == 2 * len(prefixes)  # no button without a meaning, none with two
    assert len(set(meanings.values())) == len(meanings)


def test_a_meaning_may_have_several_buttons():
    given = {"discard": ["left_top", "right_top"], "success": "left_bottom"}
    assert button_meanings(given, TWO, {}) == {
        "left_top": Meaning.DISCARD,
        "right_top": Meaning.DISCARD,
        "left_bottom": Meaning.SUCCESS,
    }


MISTAKES = [
    ({"next": "left_top", "stop": "left_top"}, {}, "left_top has two meanings: next and stop"),
    ({"next": ["left_top", "left_top"]}, {}, "left_top has two meanings"),
    ({"next": "left_top"}, {"left_top": "estop_button"}, "left_top has two meanings: estop_button and next"),
    ({"nxt": "left_top"}, {}, "no meaning of a button 'nxt'; did you mean 'next'"),
    ({"re-record": "left_top"}, {}, "did you mean 'rerecord'"),
    ({"next": "left_tpo"}, {}, "no button 'left_tpo'; did you mean 'left_top'"),
    ({"next": "top"}, {}, "no button 'top'.*left_top"),
    ({"next": 3}, {}, "buttons takes record or dagger, or meanings with their buttons"),
    ({"next": [3]}, {}, "no button 3"),
    ("recrod", {}, "no set of buttons 'recrod'; did you mean 'record'"),
    (["next"], {}, "buttons takes"),
    (True, {}, "buttons takes"),
]


@pytest.mark.parametrize(("given", "taken", "says"), MISTAKES)
def test_a_mistake_is_refused(given, taken, says):
    with pytest.raises(ConfigError, match=says):
        button_meanings(given, TWO, taken)


def test_buttons_need_a_handle():
    with pytest.raises(ConfigError, match="no arm has one"):
        button_meanings("record", [], {})


def presses(samples):
    """The looks at which a button counts as pressed, given what it was at each."""
    edges = RisingEdges()
    return [i for i, down in enumerate(samples) if edges.pressed({"top": down})]


def test_a_press_counts_once_and_at_once():
    assert presses([False, False, True, True, True, False, True, False]) == [2, 6]


def test_a_button_that_is_down_at_the_start_counts_once_it_was_up():
    assert presses([True, True, False, True]) == [3]


def test_a_button_that_is_down_when_its_handle_is_heard_again_does_not_count():
    assert presses([False, None, None, True, True, False, True]) == [6]


def test_buttons_are_independent():
    edges = RisingEdges()
    assert edges.pressed({"top": False, "bottom": False}) == []
    assert edges.pressed({"top": False, "bottom": True}) == ["bottom"]
    assert edges.pressed({"top": True, "bottom": True}) == ["top"]


def test_presses_that_the_loop_counted_between_two_looks_are_not_missed():
    presses = Presses()

    def look(left, right):
        record = np.zeros((), STATE_DTYPE)
        states = []
        for record["presses"] in (left, right):
            states.append(ArmState(record.tobytes()))
        return presses.new(dict(zip(["left_", "right_"], states, strict=True)))

    assert look((3, 0), (0, 9)) == []  # of which nothing is known: before the start
    assert look((3, 1), (0, 9)) == ["left_bottom"]
    assert look((3, 3), (1, 9)) == ["left_bottom", "left_bottom", "right_top"]
    assert look((0, 0), (1, 9)) == []  # another process drives the leader
    assert look((0, 1), (1, 9)) == ["left_bottom"]
