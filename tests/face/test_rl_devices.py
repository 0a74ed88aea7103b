"""A follower and its leader as LeRobot's RL stack asks them."""

import contextlib
import time

import numpy as np
import pytest
from lerobot.teleoperators.utils import TeleopEvents

from lerobot_robot_yam.errors import ActionError, ConfigError
from tests.face.devices.test_lerobot_contract import BiYamFollower, follower_config, leave
from tests.face.devices.test_pairing import follower, leader
from tests.support.rigged import rig_of
from tests.support.tiers import spread

BUTTONS = {"correct": "bottom", "success": "top"}
IN_RIG = {"top": "sync", "bottom": "record"}
LOOK_S = 0.2  # until the thread that watches has seen that no button is down
RESET_DEG = [0.0, 60.0, 60.0, -70.0, 0.0, 0.0, 0.2]


@contextlib.contextmanager
def connected(rig, folder):
    """A follower and a leader that watches its buttons."""
    teleop = leader(rig, folder, action_space="delta", buttons=BUTTONS)
    robot = follower(rig, folder, use_degrees=True)
    teleop.connect()
    try:
        robot.connect()
        teleop.get_teleop_events()  # from now on it watches
        yield robot, teleop
    finally:
        leave(robot)
        leave(teleop)


@pytest.fixture(scope="module")
def rig():
    with rig_of("lockstep", arms=["follower_left", "leader_left"]) as rig:
        yield rig


@pytest.fixture(scope="module")
def pair(rig, tmp_path_factory):
    with connected(rig, tmp_path_factory.mktemp("calibration")) as devices:
        yield devices


def ask_until(teleop, event, comes=True):
    """Ask until an event comes, or no more, while the rig's time passes; returns the last answer."""
    until_s = time.monotonic() + 20.0
    while time.monotonic() < until_s:
        teleop._arms.clock.sleep(0.02)
        time.sleep(0.01)  # for the thread that watches the buttons
        answer = teleop.get_teleop_events()
        if answer[event] is comes:
            return answer
    pytest.fail(f"no {event}: {answer}")


def test_the_bus_reads_what_the_robot_observes(pair):
    robot, _ = pair
    observed = robot.get_observation()
    assert list(robot.bus.motors) == [key.removesuffix(".pos") for key in observed]
    assert list(robot.bus.sync_read("Present_Position").values()) == pytest.approx(list(observed.values()), abs=0.5)
    with pytest.raises(ActionError, match="no Present_Current; leave add_current_to_observation off"):
        robot.bus.sync_read("Present_Current")


def test_a_goal_that_is_written_is_reached_however_far_it_is(pair):
    """LeRobot's reset writes a way in 0.75 s, and then nothing."""
    robot, _ = pair
    start = robot.bus.sync_read("Present_Position")
    for share in np.linspace(0.0, 1.0, 10):
        way = {name: (1.0 - share) * start[name] + share * to for name, to in zip(start, RESET_DEG, strict=True)}
        robot.bus.sync_write("Goal_Position", way)
    robot.clock.sleep(0.3)
    there = list(robot.bus.sync_read("Present_Position").values())
    assert there[:6] == pytest.approx(RESET_DEG[:6], abs=1.0) and there[6] == pytest.approx(RESET_DEG[6], abs=0.05)
    with pytest.raises(ActionError, match="Present_Position"):
        robot.bus.sync_write("Present_Position", start)


def test_buttons_are_told_once_and_take_over(pair, rig):
    _, teleop = pair
    time.sleep(LOOK_S)
    assert not any(teleop.get_teleop_events().values())
    rig.buttons("leader_left", sync=True)
    told = ask_until(teleop, TeleopEvents.SUCCESS)
    assert not told[TeleopEvents.IS_INTERVENTION] and not told[TeleopEvents.TERMINATE_EPISODE]
    assert not any(teleop.get_teleop_events().values())
    rig.buttons("leader_left", record=True)
    ask_until(teleop, TeleopEvents.IS_INTERVENTION)
    assert list(teleop.get_action().values()) == [0.0, 0.0, 0.0, 2.0]  # no step, and the gripper goes on closing
    rig.buttons("leader_left")
    teleop._arms.clock.sleep(0.1)
    time.sleep(LOOK_S)
    assert teleop.get_teleop_events()[TeleopEvents.IS_INTERVENTION]
    rig.buttons("leader_left", record=True)
    ask_until(teleop, TeleopEvents.IS_INTERVENTION, False)
    rig.buttons("leader_left")


@pytest.mark.parametrize("options", spread([{}, {"action_space": "ee", "use_degrees": True}], 0))
def test_followers_that_the_stack_would_misread_are_refused(rig, tmp_path, options):
    with pytest.raises(ConfigError, match="computes in degrees; set use_degrees"):
        follower(rig, tmp_path, **options).bus.motors  # noqa: B018
    with pytest.raises(ConfigError, match="drives one arm with a gripper"):
        BiYamFollower(follower_config("none", tmp_path, use_degrees=True)).bus.motors  # noqa: B018
