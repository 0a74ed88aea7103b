"""When a button counts as pressed."""

from lerobot_robot_yam.face.operator_keys.edges import RisingEdges


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
