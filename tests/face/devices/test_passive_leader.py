"""Leaders without motors as LeRobot teleoperators: what they tell, what they refuse, and their calibration."""

import json
import threading
import time

import numpy as np
import pytest

from lerobot_robot_yam.config_yam_follower import YamFollowerConfig
from lerobot_robot_yam.errors import ConfigError, LifeCycleError
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.yam_follower import YamFollower
from lerobot_teleoperator_yam import yam_passive_leader
from lerobot_teleoperator_yam.config_yam_passive_leader import (
    BiYamPassiveLeaderConfig,
    PassiveLeaderArmConfig,
    YamPassiveLeaderConfig,
)
from lerobot_teleoperator_yam.yam_passive_leader import BiYamPassiveLeader, YamPassiveLeader
from tests.support.rigged import STOPS
from tests.support.tiers import spread
from tests.support.waiting import wait

LEADER, OTHER, FOLLOWER = "leader_left", "leader_right", "follower_left"
THERE, FALLEN = [0.3, 1.1, 1.0, -0.3, 0.1, 0.2], [0.3, 0.3, 0.4, -0.3, 0.1, 0.2]


@pytest.fixture(scope="module")
def rig():
    with running_rig(scene="passive_leaders", arms=[LEADER, OTHER, FOLLOWER]) as rig:
        yield rig


def fields(rig, channel=LEADER):
    return {"channel": channel, "interface": "yam_sim", "can_options": {"rig": rig.name}}


def leader_on(rig, directory, **more):
    return YamPassiveLeader(YamPassiveLeaderConfig(id="test", calibration_dir=directory, **fields(rig), **more))


@pytest.mark.long
def test_two_leaders_tell_their_poses_and_buttons(rig, tmp_path):
    arms = {
        f"{name.removeprefix('leader_')}_arm_config": PassiveLeaderArmConfig(**fields(rig, name))
        for name in (LEADER, OTHER)
    }
    leaders = BiYamPassiveLeader(BiYamPassiveLeaderConfig(calibration_dir=tmp_path, **arms))
    leaders.connect()
    try:
        rig.lift(LEADER, THERE, 1.0, trigger=1.0)
        wait(lambda: leaders.get_action()["left_gripper.pos"] == 0.0)
        wait(lambda: abs(leaders.get_action()["left_joint_2.pos"] - THERE[1]) < 0.05)
        action = leaders.get_action()
        truth = [*rig.state()["arms"][LEADER]["q"], 0.0, *rig.state()["arms"][OTHER]["q"], 1.0]
        np.testing.assert_allclose([*action.values()], truth, atol=0.02)
        rig.press(OTHER, "record", 1.0)
        wait(lambda: leaders._arms.newest()[1].buttons == (False, True))
        assert leaders._arms.newest()[0].buttons == (False, False)
        wait(lambda: leaders._arms.newest()[1].buttons == (False, False))
    finally:
        leaders.disconnect()
        rig.release(LEADER)


def test_it_can_be_neither_led_nor_held(rig, tmp_path):
    leader = leader_on(rig, tmp_path)
    assert leader.feedback_features == {}
    for call in (leader.enable_torque, leader.disable_torque, lambda: leader.send_feedback({}), leader.rearm):
        with pytest.raises(LifeCycleError, match="no motors; it can be neither led nor held"):
            call()


def test_without_its_trigger_the_arm_goes_on_and_the_gripper_holds(rig, tmp_path):
    leader = leader_on(rig, tmp_path)
    leader.connect()
    try:
        rig.lift(LEADER, THERE, 0.5, trigger=0.5)
        wait(lambda: abs(leader.get_action()["gripper.pos"] - 0.5) < 0.02)
        rig.fault(LEADER, None, "encoders_silent", [6])
        time.sleep(0.6)
        rig.lift(LEADER, [0.0, *THERE[1:]], 0.5)
        wait(lambda: abs(leader.get_action()["joint_1.pos"]) < 0.05)
        assert leader.get_action()["gripper.pos"] == pytest.approx(0.5, abs=0.02)
    finally:
        leader.disconnect()
        rig.clear_faults(LEADER)
        rig.release(LEADER)


@pytest.mark.parametrize("home_rad", spread([None, [0.0, 0.4, 0.3, 0.0, 0.2, 0.0]], 1))
def test_a_calibration_finds_zeros_ranges_and_the_triggers_travel(rig, tmp_path, monkeypatch, home_rad):
    monkeypatch.setattr(yam_passive_leader, "HOME_S", 1.0)
    monkeypatch.setattr(yam_passive_leader, "MOVE_S", 6.0)
    home = [0.1, 0.5, 0.5, 0.0, 0.0, 0.0]
    told = np.zeros(6) if home_rad is None else np.array(home_rad)
    rig.lift(LEADER, home, 0.5)
    time.sleep(1.5)
    leader = leader_on(rig, tmp_path, home_rad=home_rad)
    leader.connect(calibrate=False)
    assert not leader.is_calibrated

    def move():
        time.sleep(2.0)
        rig.lift(LEADER, [0.6, 1.2, 1.2, 0.6, 0.6, 0.6], 1.0, trigger=0.8)
        time.sleep(1.5)
        rig.lift(LEADER, home, 1.0)

    person = threading.Thread(target=move)
    person.start()
    try:
        leader.calibrate()
        person.join()
        assert leader.is_calibrated
        stored = json.loads((tmp_path / "yam" / "test_passive.json").read_text())
        np.testing.assert_allclose(stored["zero_rad"], home - told, atol=0.05)
        assert stored["trigger_rad"] == pytest.approx(0.8 * 0.67, abs=0.02)
        assert all(high - low > 0.4 for low, high in stored["range_rad"])
        np.testing.assert_allclose([*leader.get_action().values()][:6], told, atol=0.05)  # it counts already
    finally:
        person.join()
        leader.disconnect()
        rig.release(LEADER)


@pytest.mark.parametrize("option", spread([{}, {"follower": FOLLOWER}]))
def test_a_leader_that_has_fallen_takes_its_follower_along_once_it_is_in_a_hand(rig, tmp_path, option):
    arm = fields(rig, FOLLOWER) | {"gravity_factor": [1.0] * 6, "gripper_stops_rad": STOPS}
    leader, follower = leader_on(rig, tmp_path, **option), YamFollower(YamFollowerConfig(**arm))
    rig.set_pose(FOLLOWER, THERE)
    rig.lift(LEADER, THERE, 0.5)
    leader.connect()

    def frames(seconds):
        for _ in range(round(seconds * 30)):
            follower.send_action(leader.get_action())
            time.sleep(1 / 30)
        return np.array(rig.state()["arms"][FOLLOWER]["q"])

    stop = EmergencyStop()
    try:
        follower.connect()
        frames(1.5)
        rig.lift(LEADER, FALLEN, 0.3)  # let go of, to stop the arms
        frames(0.2)
        stop.latch("test")
        before = frames(0.5)
        assert np.abs(before - FALLEN).max() > 0.3  # the last action was farther down
        stop.release()
        np.testing.assert_allclose(frames(1.5), before, atol=0.05)
        rig.lift(LEADER, FALLEN, 0.2, trigger=1.0)
        np.testing.assert_allclose(frames(3.0), FALLEN, atol=0.1)
    finally:
        stop.release()
        follower.disconnect()
        leader.disconnect()
        rig.release(LEADER)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"kind": "bench"}, "kind takes one of desk, mobile_left, mobile_right; got 'bench'"),
        ({"joint_sign": [1, 1, 1, 1, 1, 2]}, "joint_sign takes 1 or -1 for each of 6 joints"),
        ({"joint_sign": [1, 1]}, "joint_sign takes 1 or -1 for each of 6 joints"),
        ({"mapping": "scaled"}, "mapping takes direct or range"),
        ({"mapping": "range", "leader_range_rad": [[0.0, 1.0]] * 5}, "for each of 6 joints"),
        ({"mapping": "range", "leader_range_rad": [[1.0, 0.0]] * 6}, "at least 0.2 apart"),
        ({"leader_range_rad": [[0.0, 1.0]] * 6}, "leader_range_rad is for mapping: range"),
        ({"gate": "auto"}, "set follower to the follower's channel"),
        ({"arm": "yum"}, "yum"),
        ({"home_rad": [0.0] * 5}, "home_rad takes an angle for each of 6 joints"),
        ({"home_rad": [0.0] * 5 + [float("nan")]}, "home_rad takes an angle for each of 6 joints"),
        ({"follower": "follower_left", "gate": "button"}, "needs a gate_button"),
    ],
)
def test_what_a_config_refuses(given, message):
    with pytest.raises(ConfigError, match=message):
        YamPassiveLeaderConfig(channel=LEADER, **given)
