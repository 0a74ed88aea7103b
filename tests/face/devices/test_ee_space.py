"""End-effector keys of real devices on a rig in lock-step: what they mean, where the tool goes, what is refused."""

import functools
import itertools
import logging
import math

import numpy as np
import pytest

from lerobot_robot_yam.arm.kinematics import YamKinematics
from lerobot_robot_yam.arm.tool_pose import downward, pose_to_vector
from lerobot_robot_yam.config_yam_follower import YamFollowerConfig
from lerobot_robot_yam.errors import ActionError, ConfigError
from lerobot_robot_yam.face.devices.ee_space import Tool
from lerobot_robot_yam.face.devices.feature_names import TOOL_NUMBERS
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.yam_follower import BiYamFollower, YamFollower
from lerobot_teleoperator_yam.yam_leader import BiYamLeader
from scripts import recorders
from tests.face.devices.test_lerobot_contract import connected_pair, follower_config, leader_config, settle
from tests.support.rigged import STOPS, lockstep_rig

KEYS = [*(f"{name}.pos" for name in TOOL_NUMBERS), "gripper.pos"]
ARM = "follower_left"
BI_KEYS = [f"{side}_{key}" for side in ("left", "right") for key in KEYS]
SAG_M = 0.005  # the rig's arms hang so far below their set-points at most
READY = [0.2, 1.2, 1.1, -1.2, 0.1, -0.1]
FAR = [-1.0, 1.5, 1.5, -0.5, 0.5, 0.5]
FRAME_S = 1 / 30
rig = lockstep_rig(ARM)


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
    far = np.array(FAR)
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


# connected


@pytest.fixture
def follower(rig, tmp_path):
    """A follower by the poses of its tool; degrees mean nothing beside them."""
    options = {"interface": "yam_lockstep", "can_options": {"rig": rig.name}, "gripper_stops_rad": STOPS}
    options |= {"action_space": "ee", "use_degrees": True, "observe_velocity": True, "gravity_factor": [1.0] * 6}
    robot = YamFollower(YamFollowerConfig(channel=ARM, calibration_dir=tmp_path, isolation="lockstep", **options))
    robot.connect()
    yield robot
    robot.discard()


def numbers_of(values):
    return np.array([values[f"{name}.pos"] for name in TOOL_NUMBERS])


@functools.cache
def straight_down():
    """The rotation from which the numbers count."""
    return downward(YamKinematics("yam", "linear_4310"))


def truth(rig):
    """The numbers of where the tool really is, in the frame of the arm's base."""
    (row,) = [row for row in rig.scene()["arms"] if row["channel"] == ARM]
    site, yaw = rig.state()["arms"][ARM]["tcp_site"], row["yaw_rad"]
    turn = np.array([[math.cos(yaw), math.sin(yaw), 0], [-math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]])
    pose = np.eye(4)
    pose[:3, :3] = turn @ np.array(site["mat"]).reshape(3, 3)
    pose[:3, 3] = turn @ (np.array(site["pos"]) - row["position_m"])
    return pose_to_vector(pose, straight_down())


def send(follower, action, seconds):
    """Send the same action again and again; returns what was sent last, and the fastest that joint 1 was seen."""
    fastest = 0.0
    for _ in range(round(seconds / FRAME_S)):
        sent = follower.send_action(action)
        follower.clock.sleep(FRAME_S)
        fastest = max(fastest, abs(follower.get_observation()["joint_1.vel"]))
    return sent, fastest


def reach(follower, q, seconds, **changes):
    """Send the action that puts the tool where the joints `q` put it; returns it, what was sent, and the speed seen."""
    numbers = Tool("arm", YamKinematics("yam", "linear_4310")).numbers(np.array(q))
    asked = dict(zip(KEYS, [*numbers.tolist(), 1.0], strict=True)) | changes
    return asked, *send(follower, asked, seconds)


def test_the_tool_goes_where_it_is_sent_and_is_observed_there(follower, rig):
    asked, sent, _ = reach(follower, READY, 3.0, **{"gripper.pos": 0.4})
    assert list(sent) == KEYS and all(type(value) is float for value in sent.values())
    assert numbers_of(sent) == pytest.approx(numbers_of(asked), abs=1e-4)
    assert truth(rig)[:3] == pytest.approx(numbers_of(asked)[:3], abs=SAG_M)
    assert truth(rig)[3:] == pytest.approx(numbers_of(asked)[3:], abs=0.03)
    assert rig.state()["arms"][ARM]["opening"] == pytest.approx(0.4, abs=0.03)
    observation = follower.get_observation()
    assert list(observation) == list(follower.observation_features)
    assert numbers_of(observation) == pytest.approx(truth(rig), abs=0.01)


def test_out_of_reach_goes_to_the_border_and_a_jump_keeps_the_speed_limit(follower, rig):
    asked, sent, _ = reach(follower, READY, 3.0, **{"ee_x.pos": 0.75})
    assert sent["ee_x.pos"] < 0.7 and asked["ee_x.pos"] == 0.75
    assert truth(rig)[:3] == pytest.approx(numbers_of(sent)[:3], abs=2 * SAG_M)
    recorders.watch_start(rig, ARM)
    fastest = reach(follower, FAR, 2.0)[2]
    limits = follower._arms.sides[0].hardware.speed_limit[:6]
    assert (np.array(recorders.watch(rig, ARM)["max_speed_rad_s"][:6]) < 1.1 * limits).all()
    assert 0.3 < fastest < 1.1 * limits[0]  # rad/s, not degrees per second


WAY = [READY, [0.6, 1.5, 1.3, -0.9, 0.4, 0.2], [0.1, 1.7, 1.6, -1.1, 0.0, -0.3], [0.3, 1.4, 1.5, -1.3, 0.2, 0.2]]
LEG = 30  # frames
ERROR_M = 0.002


def off_path(points, path):
    """(k,) distance of each point from a polyline (m, 3)."""
    start, along = path[:-1], np.diff(path, axis=0)
    length = np.maximum(np.einsum("ij,ij->i", along, along), 1e-18)
    share = np.clip(np.einsum("kij,ij->ki", points[:, None] - start, along) / length, 0.0, 1.0)
    return np.linalg.norm(points[:, None] - start - share[..., None] * along, axis=2).min(axis=1)


@pytest.mark.long
def test_a_replay_brings_the_tool_along_its_way_again(follower, rig):
    reach(follower, READY, 3.0)
    share = np.linspace(0.0, 1.0, LEG, endpoint=False)[:, None]
    way = np.concatenate([before + share * np.subtract(after, before) for before, after in itertools.pairwise(WAY)])
    went, tools, actions = [], [], []
    for q in way:
        sent = follower.send_joints(np.append(q, 1.0))
        actions.append({key: float(np.float32(value)) for key, value in follower.action_for(sent).items()})
        follower.clock.sleep(FRAME_S)
        went.append(truth(rig)[:3])
        tools.append(numbers_of(follower.get_observation())[:3])
    assert off_path(np.array(tools), np.array(went)).max() < 0.005  # what is observed is where the tool is
    reach(follower, READY, 3.0)
    again = []
    for action in actions:
        follower.send_action(action)
        follower.clock.sleep(FRAME_S)
        again.append(truth(rig)[:3])
    assert np.ptp(went, axis=0).max() > 0.1
    assert off_path(np.array(again), np.array(went)).max() < ERROR_M
    assert np.linalg.norm(np.subtract(again[-1], went[-1])) < ERROR_M


@pytest.mark.parametrize(
    "change",
    [{"ee_x.pos": math.nan}, {"joint_1.pos": 0.0}, {"ee_z.pos": ...}, {"ee_rx.pos": 1e200}],
    ids=["not finite", "a joint", "left out", "no pose"],
)
def test_bad_actions_reach_no_arm(follower, change):
    observation = follower.get_observation()
    action = {key: observation[key] + 0.05 for key in KEYS} | change
    action = {key: value for key, value in action.items() if value is not ...}
    with pytest.raises(ActionError, match="no pose" if 1e200 in change.values() else next(iter(change))):
        follower.send_action(action)
    follower.clock.sleep(0.1)
    assert numbers_of(follower.get_observation()) == pytest.approx(numbers_of(observation), abs=0.01)


@pytest.mark.long
def test_followers_hold_while_a_leader_is_led_whatever_lerobot_repeats(follower):
    """Inverse kinematics answers the same pose with joints that differ in their last bits."""
    lunge, *_ = reach(follower, READY, 2.0)
    lunge["ee_z.pos"] += 0.25
    send(follower, lunge, 0.1)
    follower._arms._hold()
    follower.clock.sleep(0.7)  # longer than the command time-out
    held = follower.get_observation()["ee_z.pos"]
    assert held < lunge["ee_z.pos"] - 0.05
    send(follower, lunge, 0.5)
    assert follower.get_observation()["ee_z.pos"] == pytest.approx(held, abs=0.01)


def test_a_leaders_action_is_the_followers_tool(tmp_path):
    leader = BiYamLeader(leader_config("none", tmp_path, action_space="ee"))
    kinematics = YamKinematics("yam", "linear_4310")
    action = leader._space.action(np.array([*READY, 0.3, *FAR, 1.0]))
    assert list(action) == BI_KEYS and action["left_gripper.pos"] == 0.3
    for side, q in (("left", READY), ("right", FAR)):
        wanted = pose_to_vector(kinematics.fk(np.array(q)), downward(kinematics))
        assert [action[f"{side}_{name}.pos"] for name in TOOL_NUMBERS] == pytest.approx(wanted)


@pytest.mark.long
@pytest.mark.alone
def test_feedback_leads_the_leader_and_its_action_is_sent_as_it_is(tmp_path):
    with running_rig() as rig, connected_pair(rig, tmp_path, action_space="ee") as (follower, leader):
        goal = leader.get_action()
        assert follower.send_action(goal) == pytest.approx(goal, abs=1e-4)  # recorded = sent
        q = np.array(rig.state()["arms"]["leader_left"]["q"][:6])
        tool = Tool("left", YamKinematics("yam", "linear_4310"))
        for name, value in zip(TOOL_NUMBERS, tool.numbers(q + [0.3, 0.2, 0.2, 0, 0, 0]), strict=True):
            goal[f"left_{name}.pos"] = float(value)
        leader.enable_torque()
        settle(leader.send_feedback, goal, 2.0)
        led = rig.state()["arms"]["leader_left"]["q"][:6]
        assert led == pytest.approx(q + [0.3, 0.2, 0.2, 0, 0, 0], abs=0.05)
        leader.disable_torque()
