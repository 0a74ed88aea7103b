"""Followers that connect beside their leaders go to where those are, under a LeRobot command only."""

import pytest

from lerobot_robot_yam.errors import MotorError
from tests.face.devices.test_lerobot_contract import KEYS, leave
from tests.face.devices.test_pairing import follower, leader
from tests.support.lerobot_calls import SCRIPTS, called_by
from tests.support.rigged import rig_of


@pytest.fixture
def rig():
    with rig_of("lockstep", arms=["follower_left", "leader_left"]) as rig:
        yield rig


@pytest.fixture
def pair(rig, tmp_path):
    """A follower that is not connected, and its leader that is."""
    robot, device = follower(rig, tmp_path), leader(rig, tmp_path)
    device.connect()
    yield robot, device
    leave(robot)
    leave(device)


def test_followers_are_where_the_leaders_are_when_connect_returns(rig, pair):
    robot, device = pair
    rig.hand("leader_left", [0.8], [[0.3, 0.7, 0.6, -0.3, 0.2, 0.2]])
    device._arms.clock.sleep(1.0)
    called_by(SCRIPTS / "lerobot_teleoperate.py", "teleoperate", robot.connect)
    observation, action = robot.get_observation(), device.get_action()
    assert action["joint_2.pos"] > 0.5  # far from where the follower lay
    for key in KEYS[:-1]:
        assert observation[key] == pytest.approx(action[key], abs=0.16)


def test_followers_of_a_program_of_ones_own_stay_where_they_are(rig, pair):
    """It may have more than one pair, or lead its followers later."""
    robot, device = pair
    rig.hand("leader_left", [0.8], [[0.4, 0.6, 0.5, 0.0, 0.0, 0.0]])
    device._arms.clock.sleep(1.0)
    robot.connect()
    assert robot.get_observation()["joint_2.pos"] == pytest.approx(0.0, abs=0.1)


def test_a_leader_that_has_failed_does_not_keep_its_follower_from_connecting(rig, pair):
    robot, device = pair
    rig.fault("leader_left", "joint_5", "nibble", 0xC, sticky=True)
    device._arms.clock.sleep(0.2)
    called_by(SCRIPTS / "lerobot_teleoperate.py", "teleoperate", robot.connect)
    robot.get_observation()
    with pytest.raises(MotorError, match="joint_5"):
        device.get_action()
    rig.clear_faults("leader_left")
