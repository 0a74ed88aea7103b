"""Under X11 LeRobot listens with pynput: a pressed key arrives there. Needs Xvfb, and pynput in the environment."""

import importlib.util
import os
import shutil
import subprocess
import sys

import pytest

from tests.support.paths import ROOT

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


@pytest.fixture
def display():
    there = {"Xvfb": shutil.which("Xvfb"), "pynput": importlib.util.find_spec("pynput")}
    if missing := [name for name, found in there.items() if found is None]:
        pytest.skip(f"the keys of X11 are not tested: there is no {' and no '.join(missing)}")
    read, write = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", "640x480x8", "-nolisten", "tcp"],
        pass_fds=[write],
        stderr=subprocess.DEVNULL,
    )
    os.close(write)
    with open(read) as numbers:
        yield f":{numbers.readline().strip()}"
    server.terminate()
    server.wait()


def test_every_key_of_lerobots_arrives(display):
    environment = os.environ | {"DISPLAY": display}
    for name in ("WAYLAND_DISPLAY", "XDG_SESSION_TYPE"):
        environment.pop(name, None)
    keys = ["right", "left", "esc", "space", "tab", "enter", "s", "h"]
    subprocess.run([sys.executable, "-c", PROGRAM, *keys], check=True, cwd=ROOT, env=environment, timeout=120)
