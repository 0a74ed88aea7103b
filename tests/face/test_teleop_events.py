"""Which presses LeRobot's RL stack is told, by states as a leader publishes them."""

import time

import numpy as np
import pytest
from lerobot.teleoperators.utils import TeleopEvents

from lerobot_robot_yam.face.lerobot_command.running_command import Meaning
from lerobot_robot_yam.face.rl_stack import TeleopEventWatch
from lerobot_robot_yam.state.arm_state import ArmState
from lerobot_robot_yam.state.modes import Gate, Mode
from lerobot_robot_yam.state.records import STATE_DTYPE

LOOK_S = 0.03  # a few looks at the handle


class Handle:
    """A leader's newest state."""

    def __init__(self):
        self._record = np.zeros((), STATE_DTYPE)
        for field, value in (("joints", 6), ("motors", 6), ("mode", Mode.FLOAT), ("trigger", 1.0)):
            self._record[field] = value

    def read(self):
        return {"": ArmState(self._record.tobytes())}

    def press(self):
        """The upper button, down and up again."""
        for down in (1, 0):
            self._record["buttons"] = down, 0
            self._record["presses"][0] += down
            time.sleep(LOOK_S)


@pytest.fixture
def handle():
    return Handle()


@pytest.fixture
def watch(handle):
    watch = TeleopEventWatch({"top": Meaning.SUCCESS}, handle.read)
    watch.take()
    time.sleep(LOOK_S)
    yield watch
    watch.stop()


def test_a_press_between_two_questions_is_told_once(watch, handle):
    handle.press()
    assert watch.take()[TeleopEvents.SUCCESS]
    assert not watch.take()[TeleopEvents.SUCCESS]


def test_a_press_while_the_arm_is_reset_does_not_end_the_next_episode(watch, handle):
    """LeRobot asks for no events then, for seconds: a second press of success would label an episode of one frame."""
    handle.press()
    time.sleep(0.6)
    assert not any(watch.take().values())
    handle.press()
    assert watch.take()[TeleopEvents.SUCCESS]


@pytest.mark.parametrize(
    ("gate", "mode", "drives"),
    [
        (Gate.NONE, Mode.FLOAT, False),
        (Gate.IDLE, Mode.FLOAT, False),
        (Gate.HOMING, Mode.FLOAT, False),
        (Gate.APPROACH, Mode.FLOAT, True),
        (Gate.ENGAGED, Mode.FLOAT, True),
        (Gate.ENGAGED, Mode.STOPPED, False),
    ],
)
def test_a_person_drives_while_the_leader_is_lifted(handle, watch, gate, mode, drives):
    handle._record["gate"], handle._record["mode"] = gate, mode
    assert watch.take()[TeleopEvents.IS_INTERVENTION] is drives
