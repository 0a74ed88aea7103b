"""Pads that SDL simulates: readings, the choice among several, loss; what SDL must not do to the process."""

import signal
import subprocess
import sys

import pytest

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.driving.sdl_pads import BUTTONS, open_pad
from tests.support.virtual_pad import VirtualPad


@pytest.fixture
def plug():
    pads = []

    def plugged(*arguments, **options):
        pads.append(VirtualPad(*arguments, **options))
        return pads[-1]

    yield plugged
    for pad in pads:
        pad.unplug()


@pytest.fixture
def opened(plug):
    """A pad, and what the driver has opened."""
    real = plug()
    pad = open_pad("yam_gamepad", None)
    yield real, pad
    pad.close()


def test_axes_and_buttons_of_a_known_pad(opened):
    real, pad = opened
    assert pad.known and pad.name == "Test Pad" and not any(pad.read().buttons)
    real.push("lefty", -1.0)
    real.push("rightx", 0.5)
    real.press("b")
    reading = pad.read()
    assert reading.axes[:4] == pytest.approx([0.0, -1.0, 0.5, 0.0], abs=1e-4)
    assert [name for name, down in zip(BUTTONS, reading.buttons, strict=True) if down] == ["b"]


def test_axes_of_an_unknown_pad_have_its_own_numbers(plug):
    real = plug(known=False)
    pad = open_pad("yam_gamepad", None)
    real.push(3, 1.0)
    real.press(5)
    assert not pad.known
    assert pad.read() == ((0.0, 0.0, 0.0, pytest.approx(1.0, abs=1e-4)), (False,) * 5 + (True,))
    pad.close()


@pytest.mark.parametrize("known", [True, False])
def test_an_unplugged_pad_reads_as_none(plug, known):
    real = plug(known=known)
    pad = open_pad("yam_gamepad", None)
    real.push(0, 0.7)
    assert pad.read().axes[0] == pytest.approx(0.7, abs=1e-3)
    real.unplug()
    assert pad.read() is None and pad.read() is None
    plug(known=known)  # another one does not stand in for it
    assert pad.read() is None
    pad.close()


def test_no_pad():
    with pytest.raises(ConfigError, match="no gamepad is plugged in, or you may not read it"):
        open_pad("yam_gamepad", None)


def test_one_of_two_has_to_be_named(plug):
    plug("Left Pad", product=1)
    right = plug("Right Pad", product=2)
    with pytest.raises(ConfigError, match="there are 2 gamepads") as error:
        open_pad("yam_gamepad", None)
    options = [line.rpartition("--teleop.pad=")[2] for line in str(error.value).splitlines()[1:]]
    assert "Left Pad" in str(error.value) and "Right Pad" in str(error.value) and len(set(options)) == 2
    for wanted in ("right", options[1]):
        pad = open_pad("yam_gamepad", wanted)
        right.press("a")
        assert pad.name == "Right Pad" and pad.read().buttons[0]
        right.press("a", False)
        pad.close()
    with pytest.raises(ConfigError, match="no gamepad is called 'other'; there are:\n  Left Pad"):
        open_pad("yam_gamepad", "other")


def test_two_of_one_model(plug):
    plug(), plug()
    with pytest.raises(ConfigError, match="2 gamepads of one model; unplug all but one"):
        open_pad("yam_gamepad", None)


def test_the_process_still_ends_on_a_signal():
    """SDL would catch SIGTERM, and only put an event into its queue."""
    program = """
import time
from lerobot_robot_yam.face.driving import sdl_pads
sdl_pads._start()
print("started", flush=True)
time.sleep(60)
"""
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    with process:
        assert process.stdout.readline().strip() == "started"
        process.terminate()
        assert process.wait(30) == -signal.SIGTERM


def test_without_pygame():
    program = """
import sys
sys.modules["pygame"] = None
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.driving.sdl_pads import open_pad
try:
    open_pad("yam_gamepad", None)
except ConfigError as error:
    print(error)
"""
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert "read with pygame-ce, which is missing" in said and '".[gamepad]"' in said
