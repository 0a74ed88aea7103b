"""A leader and a follower of one program: actions that do not fit are found before the second is energised."""

import contextlib
from functools import partial

import pytest

from lerobot_robot_yam.config_yam_follower import YamFollowerConfig
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.yam_follower import YamFollower
from lerobot_teleoperator_yam.config_yam_leader import YamLeaderConfig
from lerobot_teleoperator_yam.yam_leader import BiYamLeader, YamLeader
from tests.face.devices.test_lerobot_contract import STOPS_RAD, enabled, leader_config, leave, on_rig
from tests.support import seven_joints
from tests.support.rigged import rig_of


@pytest.fixture
def rig():
    with rig_of("lockstep") as rig:
        yield rig


def follower(rig, tmp_path, **options):
    fields, more = on_rig(rig.name, channel="follower_left", gripper_stops_rad=STOPS_RAD)
    return YamFollower(YamFollowerConfig(calibration_dir=tmp_path, **more, **fields | options))


def leader(rig, tmp_path, **options):
    fields, more = on_rig(rig.name, channel="leader_left")
    return YamLeader(YamLeaderConfig(calibration_dir=tmp_path, **more, **fields | options))


def test_leaders_that_do_not_fit_the_follower_stay_limp(rig, tmp_path):
    single, double = partial(leader, rig, tmp_path), BiYamLeader(leader_config(rig.name, tmp_path))
    robot = follower(rig, tmp_path)
    robot.connect()
    try:
        for device, says in [
            (single(use_degrees=True), "yam_leader and yam_follower: one uses degrees; give both the same use_degrees"),
            (single(action_space="ee"), "joints, the other of tool poses; give both the same action_space"),
            (single(ee_gripper="no_gripper"), "only one has gripper.pos; set ee_gripper of the leader's arm"),
            (double, "drive one arm with one, or two with two"),
            (single(follower_arm="big_yam"), "big_yam with .*set follower_arm and ee_gripper"),
        ]:
            with pytest.raises(ConfigError, match=says):
                device.connect()
            assert not device.is_connected and not any(enabled(rig, "leader_left") + enabled(rig, "leader_right"))
    finally:
        leave(robot)


def test_a_leader_that_fits_is_energised_and_a_follower_that_does_not_is_not(rig, tmp_path):
    device = leader(rig, tmp_path, action_space="ee")
    device.connect()
    try:
        with pytest.raises(ConfigError, match="yam_follower and yam_leader: one speaks of joints"):
            follower(rig, tmp_path).connect()
        with pytest.raises(ConfigError, match="linear_4310, the other of yam with crank_4310|crank_4310, the other"):
            follower(rig, tmp_path, action_space="ee", gripper="crank_4310").connect()
        assert any(enabled(rig, "leader_left")) and not any(enabled(rig, "follower_left"))
    finally:
        leave(device)


def test_an_arm_of_seven_joints_leads_another(tmp_path):
    with contextlib.closing(LockstepRig(seven_joints.write_scene(tmp_path))) as rig:
        options = {"arm": seven_joints.ARM, "gravity_factor": [1.0] * 7}
        device, robot = leader(rig, tmp_path, **options), follower(rig, tmp_path, **options)
        device.connect()
        robot.connect()
        start = rig.state()["arms"]["leader_left"]["q"]
        rig.hand("leader_left", [0.5, 2.5], [start, seven_joints.REACH], [0.0, 1.0])
        for _ in range(120):
            action, observation = device.get_action(), robot.get_observation()
            assert robot.send_action(action) == pytest.approx(action)
            robot.clock.sleep(1 / 30)
        leave(robot)
        leave(device)
    assert list(observation) == list(action) == seven_joints.KEYS
    assert list(action.values()) == pytest.approx([*seven_joints.REACH, 0.0], abs=0.05)
    assert list(observation.values()) == pytest.approx(list(action.values()), abs=0.05)
