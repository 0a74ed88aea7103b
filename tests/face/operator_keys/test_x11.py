"""Under X11 LeRobot listens with pynput: a pressed key arrives there. Needs Xvfb, and pynput in the environment."""

import importlib.util
import subprocess
import sys

import pytest

from tests.support.paths import ROOT
from tests.support.virtual_screen import virtual_screen

PROGRAM = """
import sys, time
from lerobot.utils.keyboard_input import create_key_listener
from lerobot_robot_yam.face.operator_keys.keyboard import X11Keyboard, keyboard
before = sys.stdin
way = keyboard()
assert isinstance(way, X11Keyboard), way
way.take()
assert sys.stdin is before
heard = []
listener = create_key_listener(heard.append)
time.sleep(0.5)
keys = sys.argv[1:]
for key in keys:
    way.press(key)
deadline = time.monotonic() + 10.0
while heard != keys and time.monotonic() < deadline:
    time.sleep(0.01)
way.give_back()
listener.stop()
assert heard == keys, heard
"""


def test_every_key_of_lerobots_arrives():
    if importlib.util.find_spec("pynput") is None:
        pytest.skip("the keys of X11 are not tested: there is no pynput")
    keys = ["right", "left", "esc", "space", "tab", "enter", "s", "h"]
    with virtual_screen() as screen:
        subprocess.run([sys.executable, "-c", PROGRAM, *keys], check=True, cwd=ROOT, env=screen, timeout=120)
