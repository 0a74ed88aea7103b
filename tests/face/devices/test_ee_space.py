"""End-effector keys of the real devices on a virtual rig: what they mean, where the tool goes, what is refused."""

import logging
import math
import time

import numpy as np
import pytest
import torch

from lerobot_robot_yam.arm.kinematics import YamKinematics
from lerobot_robot_yam.arm.tool_pose import downward, pose_to_vector
from lerobot_robot_yam.config_yam_follower import YamFollowerConfig
from lerobot_robot_yam.errors import ActionError, ConfigError
from lerobot_robot_yam.face.devices.ee_space import Tool
from lerobot_robot_yam.face.devices.feature_names import TOOL_NUMBERS
from lerobot_robot_yam.rig.client.rig_control import running_rig
from lerobot_robot_yam.yam_follower import BiYamFollower, YamFollower
from lerobot_teleoperator_yam.config_yam_leader import YamLeaderConfig
from lerobot_teleoperator_yam.yam_leader import BiYamLeader, YamLeader
from tests.face.devices.test_lerobot_contract import connected_pair, follower_config, leader_config, settle

KEYS = [*(f"{name}.pos" for name in TOOL_NUMBERS), "gripper.pos"]
BI_KEYS = [f"{side}_{key}" for side in ("left", "right") for key in KEYS]
SAG_M = 0.005  # the rig's arms hang so far below their set-points at most
READY = [0.2, 1.2, 1.1, -1.2, 0.1, -0.1]


# what is known before anything is connected


def test_features_are_the_tools(tmp_path):
    robot = BiYamFollower(follower_config("none", tmp_path, action_space="ee", observe_velocity=True))
    leader = BiYamLeader(leader_config("none", tmp_path, action_space="ee"))
    assert list(robot.action_features) == BI_KEYS == list(leader.action_features) == list(leader.feedback_features)
    assert list(robot.observation_features)[:14] == BI_KEYS
    assert list(robot.observation_features)[14] == "left_joint_1.vel"
    assert all(key.endswith(".pos") for key in BI_KEYS)  # rollout drops what does not


def test_an_arm_without_gripper_has_six_keys(tmp_path):
    robot = YamFollower(
        YamFollowerConfig(channel="x", gripper="no_gripper", action_space="ee", calibration_dir=tmp_path)
    )
    assert list(robot.action_features) == KEYS[:-1]


@pytest.mark.parametrize(
    ("fields", "named"), [({"arm": "none"}, "gripper alone"), ({"action_space": "tool"}, "joint or ee")]
)
def test_what_has_no_tool_pose_is_refused(tmp_path, fields, named):
    config = YamFollowerConfig(**{"channel": "x", "action_space": "ee", "calibration_dir": tmp_path, **fields})
    with pytest.raises(ConfigError, match=named):
        YamFollower(config)


def test_a_leader_needs_to_know_the_followers_gripper(tmp_path):
    with pytest.raises(ConfigError, match="claw"):
        YamLeader(YamLeaderConfig(channel="x", ee_gripper="claw", calibration_dir=tmp_path))


# one tool, without an arm


@pytest.fixture
def kinematics():
    return YamKinematics("yam", "linear_4310")


@pytest.fixture
def tool(kinematics):
    return Tool("left", kinematics)


def test_a_path_begins_at_the_set_point_and_keeps_its_own_side(tool, kinematics):
    """The same pose can be had turned round and bent over backward."""
    both = np.array([[2.6, 0.36, 1.01, 1.03, -0.69, -1.36], [-0.54, 0.8, 0.97, 1.29, 0.69, 1.78]])
    numbers = tool.numbers(both[0])
    for q in both:
        tool.begin()
        assert tool.joints(numbers, q + 0.05) == pytest.approx(q, abs=0.01)
    # An arm that lags behind, even on the other side, does not change it.
    assert tool.joints(numbers, both[0]) == pytest.approx(both[1], abs=0.01)


def test_a_path_that_begins_beside_the_tool_does_not_turn_the_arm_round(tool, kinematics):
    setpoint = np.array([0.59, 0.39, 2.26, 1.19, 0.23, -2.07])  # the wrist all but at its limit
    beyond = kinematics.fk(setpoint - [0, 0, 0, 0, 0, 0.4])  # in reach, but of the arm turned by half a turn
    assert np.abs(tool.follow(beyond, setpoint) - setpoint).max() < 0.7


def test_a_jump_begins_a_new_path(tool):
    tool.joints(tool.numbers(np.array(READY)), np.array(READY))
    far = np.array([-1.0, 1.5, 1.5, -0.5, 0.5, 0.5])
    assert tool.joints(tool.numbers(far), far + 0.1) == pytest.approx(far, abs=1e-3)


def test_out_of_reach_is_said_once(tool, kinematics, caplog):
    numbers = tool.numbers(np.array(READY))
    q = np.array(READY)
    with caplog.at_level(logging.WARNING):
        for step in range(100):
            q = tool.joints(numbers + [0.01 * step, 0, 0, 0, 0, 0], q)
            assert (q >= kinematics.lower).all() and (q <= kinematics.upper).all()
    (record,) = caplog.records
    assert "left: pose out of reach" in record.message and "mm" in record.message
    assert kinematics.fk(q)[0, 3] > 0.5  # it went as far as the arm reaches
    with caplog.at_level(logging.WARNING):
        for _ in range(20):  # to and fro across the border
            tool.joints(numbers, q)
            tool.joints(numbers + [1.0, 0, 0, 0, 0, 0], q)
        assert len(caplog.records) == 1
        for _ in range(40):  # a second later
            tool.joints(numbers, q)
        tool.joints(numbers + [1.0, 0, 0, 0, 0, 0], q)
    assert len(caplog.records) == 2


def test_out_of_reach_moves_smoothly(tool):
    """Along the border of the workspace and back: no set-point leaps to another side."""
    numbers, q = tool.numbers(np.array(READY)), np.array(READY)
    turn = np.concatenate([np.linspace(0.0, 0.6, 60), np.linspace(0.6, 0.0, 60)])
    for step in turn:
        before, q = q, tool.joints(numbers + [step, 0.3 * step, 0, 0, 0, 0], q)
        assert np.abs(q - before).max() < 0.3
    assert tool.numbers(q) == pytest.approx(numbers, abs=1e-3)


def test_degrees_mean_nothing_beside_tool_poses(rig, tmp_path):
    """A data set of tool poses is called the same with and without them."""
    options = {"interface": "yam_sim", "can_options": {"rig": rig.name}, "gripper_stops_rad": [3.25, -3.3]}
    config = YamFollowerConfig(
        channel="follower_left", calibration_dir=tmp_path, action_space="ee", use_degrees=True, **options
    )
    config.observe_velocity = True
    robot, fastest = YamFollower(config), 0.0
    robot.connect()
    try:
        target = robot.joints() + np.array([0.5, 0, 0, 0, 0, 0, 0])
        for _ in range(40):
            robot.send_joints(target)
            time.sleep(0.02)
            fastest = max(fastest, abs(robot.get_observation()["joint_1.vel"]))
    finally:
        robot.disconnect()
    assert 0.3 < fastest < 4.0  # rad/s; the limit is 1.5


# connected


@pytest.fixture(scope="module")
def shared_rig():
    with running_rig() as rig:
        yield rig


@pytest.fixture(scope="module")
def pair(shared_rig, tmp_path_factory):
    directory = tmp_path_factory.mktemp("calibration")
    with connected_pair(shared_rig, directory, action_space="ee", use_degrees=True) as devices:
        yield devices


@pytest.fixture
def follower(pair):
    return pair[0]


@pytest.fixture
def leader(pair):
    return pair[1]


def tool_in_base(rig, channel):
    """(4, 4) true pose of an arm's tcp_site in the frame of its base."""
    (row,) = [row for row in rig.scene()["arms"] if row["channel"] == channel]
    site, yaw = rig.state()["arms"][channel]["tcp_site"], row["yaw_rad"]
    turn = np.array([[math.cos(yaw), math.sin(yaw), 0], [-math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]])
    pose = np.eye(4)
    pose[:3, :3] = turn @ np.array(site["mat"]).reshape(3, 3)
    pose[:3, 3] = turn @ (np.array(site["pos"]) - row["position_m"])
    return pose


def numbers_of(values, side):
    return np.array([values[f"{side}_{name}.pos"] for name in TOOL_NUMBERS])


def reach(rig, follower, side, q, **changes):
    """Send the action that puts the tool of one side where the joints `q` put it, until it is as near as it comes.

    Returns:
        what was sent last, what was asked for, and the numbers of where the tool really is.
    """
    kinematics = YamKinematics("yam", "linear_4310")
    asked = follower.get_observation() | {
        f"{side}_{name}.pos": float(value)
        for name, value in zip(TOOL_NUMBERS, Tool(side, kinematics).numbers(np.array(q)), strict=True)
    }
    asked |= changes
    deadline = time.monotonic() + 8.0
    while True:
        sent = settle(follower.send_action, asked, 0.3)
        truth = pose_to_vector(tool_in_base(rig, f"follower_{side}"), downward(kinematics))
        if np.linalg.norm(truth[:3] - numbers_of(sent, side)[:3]) < SAG_M or time.monotonic() > deadline:
            return sent, asked, truth


@pytest.mark.alone
def test_observed_is_where_the_tool_is(follower, shared_rig):
    observation = follower.get_observation()
    assert list(observation) == list(follower.observation_features) == BI_KEYS
    assert all(type(value) is float and math.isfinite(value) for value in observation.values())
    reference = downward(YamKinematics("yam", "linear_4310"))
    for side in ("left", "right"):
        truth = pose_to_vector(tool_in_base(shared_rig, f"follower_{side}"), reference)
        assert numbers_of(observation, side) == pytest.approx(truth, abs=0.01)


@pytest.mark.alone
def test_the_tool_goes_where_it_is_sent(follower, shared_rig):
    sent, asked, truth = reach(shared_rig, follower, "left", READY, **{"left_gripper.pos": 0.4})
    assert list(sent) == BI_KEYS
    assert numbers_of(sent, "left") == pytest.approx(numbers_of(asked, "left"), abs=1e-4)
    assert truth[:3] == pytest.approx(numbers_of(asked, "left")[:3], abs=SAG_M)
    assert truth[3:] == pytest.approx(numbers_of(asked, "left")[3:], abs=0.03)
    assert shared_rig.state()["arms"]["follower_left"]["opening"] == pytest.approx(0.4, abs=0.03)


@pytest.mark.alone
def test_out_of_reach_goes_to_the_border_and_is_returned(follower, shared_rig):
    sent, asked, truth = reach(shared_rig, follower, "left", READY, **{"left_ee_x.pos": 0.75})
    assert sent["left_ee_x.pos"] < 0.7 and asked["left_ee_x.pos"] == 0.75
    assert truth[:3] == pytest.approx(numbers_of(sent, "left")[:3], abs=2 * SAG_M)
    reach(shared_rig, follower, "left", READY)


@pytest.mark.alone
def test_a_jump_is_approached_at_the_speed_limit(follower, shared_rig):
    reach(shared_rig, follower, "left", READY)
    shared_rig.watch_start("follower_left")
    reach(shared_rig, follower, "left", [-1.0, 1.5, 1.5, -0.5, 0.5, 0.5])
    shared_rig.watch_stop("follower_left")
    fastest = np.array(shared_rig.watch("follower_left")["max_speed_rad_s"][:6])
    limits = follower._arms.sides[0].hardware.speed_limit[:6]
    assert (fastest < 2 * limits).all(), fastest  # a busy machine makes the rig's arms lurch
    reach(shared_rig, follower, "left", READY)


@pytest.mark.alone
def test_tensors_are_numbers(follower):
    action = {key: torch.tensor(value) for key, value in follower.get_observation().items()}
    assert all(type(value) is float for value in follower.send_action(action).values())


@pytest.mark.alone
@pytest.mark.parametrize(
    "change",
    [
        {"left_ee_x.pos": math.nan},
        {"right_ee_rz.pos": math.inf},
        {"left_ee_ry.pos": "far"},
        {"left_joint_1.pos": 0.0},
        {"left_ee_z.pos": ...},  # left out
        {"left_ee_rx.pos": 1e200},
    ],
    ids=str,
)
def test_bad_actions_reach_no_arm(follower, change):
    observation = follower.get_observation()
    action = {key: value + 0.05 for key, value in observation.items()} | change
    action = {key: value for key, value in action.items() if value is not ...}
    with pytest.raises(ActionError, match="no pose" if 1e200 in change.values() else next(iter(change))):
        follower.send_action(action)
    time.sleep(0.1)
    assert follower.get_observation() == pytest.approx(observation, abs=0.01)


@pytest.mark.alone
def test_leader_action_is_the_followers_tool(follower, leader, shared_rig):
    action = leader.get_action()
    assert list(action) == list(follower.action_features)
    q = np.array(shared_rig.state()["arms"]["leader_left"]["q"][:6])
    kinematics = YamKinematics("yam", "linear_4310")
    inside = np.clip(q, kinematics.lower, kinematics.upper)
    wanted = pose_to_vector(kinematics.fk(inside), downward(kinematics))
    assert numbers_of(action, "left") == pytest.approx(wanted, abs=0.01)
    assert follower.send_action(action) == pytest.approx(action, abs=1e-4)  # recorded = sent


@pytest.mark.long
@pytest.mark.alone
def test_feedback_leads_the_leader(leader, shared_rig):
    q = np.array(shared_rig.state()["arms"]["leader_left"]["q"][:6])
    goal = leader.get_action()
    tool = Tool("left", YamKinematics("yam", "linear_4310"))
    for name, value in zip(TOOL_NUMBERS, tool.numbers(q + [0.3, 0.2, 0.2, 0, 0, 0]), strict=True):
        goal[f"left_{name}.pos"] = float(value)
    leader.enable_torque()
    try:
        settle(leader.send_feedback, goal, 2.0)
        led = shared_rig.state()["arms"]["leader_left"]["q"][:6]
        assert led == pytest.approx(q + [0.3, 0.2, 0.2, 0, 0, 0], abs=0.05)
    finally:
        leader.disable_torque()


@pytest.mark.alone
@pytest.mark.long
def test_followers_hold_while_a_leader_is_led_whatever_lerobot_repeats(follower, leader, shared_rig):
    """Inverse kinematics answers the same pose with joints that differ in their last bits."""
    reach(shared_rig, follower, "left", READY)
    lunge = follower.get_observation()
    lunge["left_ee_z.pos"] += 0.25
    settle(follower.send_action, lunge, 0.1)
    leader.enable_torque()
    try:
        time.sleep(0.7)  # longer than the command time-out
        held = follower.get_observation()["left_ee_z.pos"]
        assert held < lunge["left_ee_z.pos"] - 0.05
        settle(follower.send_action, lunge, 0.5)
        assert follower.get_observation()["left_ee_z.pos"] == pytest.approx(held, abs=0.01)
    finally:
        leader.disable_torque()
        reach(shared_rig, follower, "left", READY)
