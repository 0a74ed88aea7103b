"""Followers that connect beside their leaders go to where those are, under a LeRobot command only."""

import contextlib
import time

import pytest

from lerobot_robot_yam.config_yam_follower import YamFollowerConfig
from lerobot_robot_yam.errors import MotorError
from lerobot_robot_yam.yam_follower import YamFollower
from lerobot_teleoperator_yam.config_yam_leader import YamLeaderConfig
from lerobot_teleoperator_yam.yam_leader import YamLeader
from tests.face.devices.test_lerobot_contract import FIELDS, KEYS, STOPS_RAD
from tests.support.lerobot_calls import SCRIPTS, called_by


@contextlib.contextmanager
def single_pair(rig, calibration_dir):
    """A leader that is connected, and its follower that is not."""
    fields = {"can_options": {"rig": rig.name}, "calibration_dir": calibration_dir, **FIELDS}
    leader = YamLeader(YamLeaderConfig(channel="leader_left", **fields))
    follower = YamFollower(YamFollowerConfig(channel="follower_left", gripper_stops_rad=STOPS_RAD, **fields))
    leader.connect()
    try:
        yield follower, leader
    finally:
        follower.disconnect()
        leader.disconnect()


@pytest.mark.alone
def test_followers_are_where_the_leaders_are_when_connect_returns(rig, tmp_path):
    with single_pair(rig, tmp_path) as (follower, leader):
        rig.hand("leader_left", [0.8], [[0.3, 0.7, 0.6, -0.3, 0.2, 0.2]])
        time.sleep(1.0)
        called_by(SCRIPTS / "lerobot_teleoperate.py", "teleoperate", follower.connect)
        observation, action = follower.get_observation(), leader.get_action()
        assert action["joint_2.pos"] > 0.5  # far from where the follower lay
        for key in KEYS[:-1]:
            assert observation[key] == pytest.approx(action[key], abs=0.16)


@pytest.mark.alone
@pytest.mark.long
def test_followers_of_a_program_of_ones_own_stay_where_they_are(rig, tmp_path):
    """It may have more than one pair, or lead its followers later."""
    with single_pair(rig, tmp_path) as (follower, _):
        rig.hand("leader_left", [0.8], [[0.4, 0.6, 0.5, 0.0, 0.0, 0.0]])
        time.sleep(1.0)
        follower.connect()
        assert follower.get_observation()["joint_2.pos"] == pytest.approx(0.0, abs=0.1)


@pytest.mark.alone
def test_a_leader_that_has_failed_does_not_keep_its_follower_from_connecting(rig, tmp_path):
    with single_pair(rig, tmp_path) as (follower, leader):
        rig.fault("leader_left", "joint_5", "nibble", 0xC, sticky=True)
        time.sleep(0.2)
        called_by(SCRIPTS / "lerobot_teleoperate.py", "teleoperate", follower.connect)
        follower.get_observation()
        with pytest.raises(MotorError, match="joint_5"):
            leader.get_action()
        rig.clear_faults("leader_left")
