"""Keys for the driver itself: beside LeRobot's listener, and without one."""

import os

import pytest
from lerobot.utils import keyboard_input

from lerobot_robot_yam.face.operator_keys.typed_keys import listen
from tests.support.waiting import wait


@pytest.fixture
def typing(monkeypatch):
    """Types into the terminal that is standard input here."""
    if keyboard_input.pynput_can_capture():
        pytest.skip("the keys of the desktop count here")
    master, slave = os.openpty()
    with open(slave) as file, open(master, "wb", buffering=0) as typing:
        monkeypatch.setattr("sys.stdin", file)
        yield typing.write


def record_loop(pressed, listener):
    """Calls as a command of LeRobot's does, which has its listener in a variable of this name."""
    return listen(pressed)


def test_a_key_is_heard_beside_lerobots_listener(typing):
    theirs, ours = [], []
    listener = keyboard_input.create_key_listener(theirs.append)
    end = record_loop(ours.append, listener)
    typing(b"g\x1b[C")
    wait(lambda: len(theirs) == 2)
    assert ours == theirs == ["g", "right"]
    end()
    typing(b"x")
    wait(lambda: len(theirs) == 3)
    assert ours == ["g", "right"]  # not when it has ended,
    end = record_loop(ours.append, listener)
    typing(b"y")
    wait(lambda: len(theirs) == 4)
    assert ours == ["g", "right", "y"]  # and once only in the next session
    end()
    listener.stop()


def test_a_key_is_heard_where_lerobot_listens_to_none(typing):
    ours = []
    end = listen(ours.append)
    typing(b"j")
    wait(lambda: ours == ["j"])
    end()


def test_what_a_key_breaks_does_not_cost_lerobot_the_key(typing, caplog):
    theirs = []
    listener = keyboard_input.create_key_listener(theirs.append)
    record_loop(lambda key: 1 / 0, listener)
    typing(b"g")
    wait(lambda: theirs == ["g"])
    assert "'g' was not understood" in caplog.text
    listener.stop()
