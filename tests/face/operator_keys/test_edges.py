"""When a button counts as pressed."""

import itertools

import pytest

from lerobot_robot_yam.face.operator_keys.edges import RisingEdges

TICK_S = 0.005


def presses(samples):
    """Times at which a button counts as pressed, given what it was at each look, every 5 ms."""
    edges = RisingEdges()
    return [i for i, down in enumerate(samples) if edges.pressed(i * TICK_S, {"top": down})]


def runs(*lengths):
    """Samples: up for so long, down for so long, …"""
    return [bool(i % 2) for i, length in enumerate(lengths) for _ in range(length)]


def test_a_press_counts_at_its_first_look():
    assert presses(runs(20, 30, 20, 1, 20)) == [20, 70]


@pytest.mark.parametrize("bounces", list(itertools.product((1, 2, 3), repeat=4)))
def test_a_bounce_is_no_other_press(bounces):
    assert presses(runs(20, *bounces, 30, *bounces, 20)) == [20]


def test_a_button_that_is_down_at_the_start_counts_once_it_was_up():
    assert presses([True] * 50 + [False] * 20 + [True] * 5) == [70]


def test_a_button_that_is_down_when_its_handle_is_heard_again_does_not_count():
    assert presses([False] * 20 + [None] * 50 + [True] * 30 + [False] * 20 + [True]) == [120]


def test_a_button_that_is_held_counts_once_however_seldom_it_is_looked_at():
    edges = RisingEdges()
    assert [edges.pressed(i * 0.5, {"top": i > 0}) for i in range(4)] == [[], ["top"], [], []]


def test_buttons_are_independent():
    edges = RisingEdges()
    assert edges.pressed(0.0, {"top": False, "bottom": False}) == []
    assert edges.pressed(1.0, {"top": False, "bottom": True}) == ["bottom"]
    assert edges.pressed(2.0, {"top": True, "bottom": True}) == ["top"]
