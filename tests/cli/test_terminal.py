"""lerobot-record in a user's terminal while handles press keys too: typing works, and the terminal stays what it was.

The default tier runs a typed key, `-m long` the ways to end.
"""

import signal
import time

import pytest
from lerobot.datasets import LeRobotDataset

from tests.cli.conftest import CALM
from tests.cli.test_buttons import BUTTONS, Handles, press
from tests.support.waiting import wait

pytestmark = pytest.mark.alone

LINES = (True, True)  # it shows what is typed, and waits for whole lines


class TypedSession(Handles):
    """A recording in a terminal of its own."""

    def start(self):
        self.terminal = self.commands.in_terminal("lerobot-record", f"--config_path={self.config}", *CALM)
        self.terminal.wait_shown("Recording episode 0", 120.0)
        time.sleep(1.0)

    def abandon(self):
        terminal = getattr(self, "terminal", None)
        if terminal is not None:
            if terminal.shell.poll() is None:
                terminal.close()
                self.rig.end()
            terminal.close()

    def assert_as_it_was(self):
        before, after = self.terminal.modes()
        assert before == after, self.terminal.shown[-4000:]


@pytest.fixture
def session(commands):
    session = TypedSession(commands, buttons=BUTTONS)
    session.start()
    yield session
    session.abandon()


@pytest.mark.long
def test_typed_keys_and_buttons_work_together(session):
    terminal = session.terminal
    assert terminal.echoes == (False, False)
    terminal.type(b"\x1b[C")
    terminal.wait_shown("Reset the environment")
    press(session.rig, BUTTONS["next"])
    terminal.wait_shown("Recording episode 1")
    time.sleep(1.0)
    terminal.type(b"q")
    assert terminal.end() == 0
    assert LeRobotDataset("local/yam_sim", root=session.root).num_episodes == 2
    assert "[C" not in terminal.shown.replace("\x1b[K", "")
    session.assert_as_it_was()
    session.commands.assert_landed()


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_a_signal_ends_it(session, number):
    if number is signal.SIGINT:
        session.terminal.type(b"\x03")
    else:
        session.terminal.kill(number)
    killed = number is signal.SIGKILL
    assert session.terminal.end() == 128 + (number if killed else signal.SIGINT)
    if not killed:  # LeRobot's listener cannot give the terminal back then
        session.assert_as_it_was()
    wait(lambda: not killed or not session.commands.enabled(), 20.0, "nobody landed the arms")
    session.commands.assert_landed()


@pytest.mark.long
def test_a_fault_ends_it(session):
    session.rig.fault("follower_left", "joint_5", "nibble", 0xC, sticky=True)
    assert session.terminal.end(120.0) == 1
    session.assert_as_it_was()
