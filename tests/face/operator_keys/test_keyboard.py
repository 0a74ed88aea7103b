"""Keys for the driver itself, typed into a terminal."""

import os
import time

import pytest
from lerobot.utils import keyboard_input

from lerobot_robot_yam.face.operator_keys.keyboard import TypedKeys


@pytest.fixture
def terminal(monkeypatch):
    """Descriptor to type into, and the keys that were heard."""
    if keyboard_input.pynput_can_capture():
        pytest.skip("the keys of the desktop count here")
    master, slave = os.openpty()
    heard = []
    keys = TypedKeys(heard.append)
    with open(slave) as file, open(master, "wb", buffering=0) as typing:
        monkeypatch.setattr("sys.stdin", file)
        keys.start()
        yield typing, heard
        keys.stop()


@pytest.mark.parametrize(
    ("typed", "keys"),
    [
        (b"gx\n", "gx\n"),
        (b"\x1b[D\x1b[1;5Cg\n", "g\n"),  # arrows, with Ctrl, too
        (b"\x1bOA\x1b[3~\x1b[15~g\n", "g\n"),  # a keypad's arrow, Del, F5
        (b"\x1b[d\x1bOag\n", "g\n"),  # as rxvt sends arrows with Shift and Ctrl
        (b"\x1bgj\n", "j\n"),  # Alt and g
        ("ä\x1b[Bf\n".encode(), "äf\n"),
    ],
)
def test_sequences_of_special_keys_are_no_typed_letters(terminal, typed, keys):
    typing, heard = terminal
    typing.write(typed)
    deadline = time.monotonic() + 5.0
    while "\n" not in heard:
        assert time.monotonic() < deadline, heard
        time.sleep(0.01)
    assert "".join(heard) == keys
