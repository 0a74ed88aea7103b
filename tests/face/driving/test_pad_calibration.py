"""A person who does what the calibration asks, and persons who do not."""

import pytest

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.driving.pad_calibration import RATE_HZ, record_map
from lerobot_robot_yam.face.driving.pad_map import AxisUse
from lerobot_robot_yam.face.driving.sdl_pads import Reading

REST = [0.05, 0.0, -0.1, 0.0, -1.0]  # the last is a trigger, which rests at its end
BUTTONS = 6


class Person:
    """Answers each request by moving the pad, over some readings. moves: words in a request → moves."""

    def __init__(self, moves):
        self._moves, self._coming, self.asked = moves, [], []

    def tell(self, text):
        self.asked.append(text)
        (move,) = [move for words, move in self._moves.items() if words in text] or [None]
        self._coming += move or []

    def readings(self):
        while True:
            axes, button = self._coming.pop(0) if self._coming else ({}, None)
            values = tuple(axes.get(n, rest) for n, rest in enumerate(REST))
            yield Reading(values, tuple(n == button for n in range(BUTTONS)))


def pushed(axis, end):
    """A stick that goes to its end and back."""
    rest = REST[axis]
    return [({axis: rest + (end - rest) * share}, None) for share in (0.3, 0.7, 1.0, 0.9, 0.1)]


def pressed(button):
    return [({}, None), ({}, button), ({}, button), ({}, None)]


MOVES = {
    "drive forward": pushed(1, -0.9),
    "drive backward": pushed(1, 1.0),
    "drive to the left": pushed(0, -1.0),
    "drive to the right": pushed(0, 0.95),
    "turn to the left": pushed(2, 1.0),
    "turn to the right": pushed(2, -1.0),
    "rail up": pushed(3, -1.0),
    "rail down": pushed(3, 1.0),
    "emergency stop": pressed(0),
    "switches between": pressed(2),
    "resets the odometry": [*pressed(2), *pressed(3)],  # a button that has a use already does not count
    "makes the base slow": pressed(5),
    "takes over": pressed(0),  # none
}


def test_a_pad_is_learnt():
    person = Person(MOVES)
    found = record_map(person.readings(), person.tell, rail=True)
    assert found.axes == {
        "x": AxisUse(1, pytest.approx(0.0), -0.9, 1.0),
        "y": AxisUse(0, pytest.approx(0.05), -1.0, 0.95),
        "theta": AxisUse(2, pytest.approx(-0.1), 1.0, -1.0),
        "height": AxisUse(3, pytest.approx(0.0), -1.0, 1.0),
    }
    assert found.buttons == {"stop": 0, "frame": 2, "reset": 3, "slow": 5}


def test_without_a_rail_nobody_asks_for_it():
    person = Person(MOVES)
    assert "height" not in record_map(person.readings(), person.tell, rail=False).axes
    assert not [text for text in person.asked if "rail" in text]


def test_a_shaking_stick_is_waited_for():
    person = Person(MOVES)
    shaken = [({0: 0.9 * (n % 2)}, None) for n in range(int(3 * RATE_HZ))]
    person._coming += shaken
    assert record_map(person.readings(), person.tell, rail=False).axes["y"].rest == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"drive backward": pushed(0, 1.0)}, "not the other end of axis 1"),
        ({"drive backward": pushed(1, -1.0)}, "not the other end of axis 1"),
        ({"turn to the left": pushed(1, 1.0)}, "turn to the left in place: nothing came for 30 s"),  # already taken
        ({"emergency stop": []}, "emergency stop: nothing came for 30 s; nothing was stored"),
    ],
    ids=str,
)
def test_something_else_than_what_was_asked(changes, why):
    person = Person(MOVES | changes)
    with pytest.raises(ConfigError, match=why):
        record_map(person.readings(), person.tell, rail=True)
