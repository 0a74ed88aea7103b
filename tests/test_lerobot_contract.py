"""What LeRobot's loops rely on, asked of the real devices on a virtual rig."""

import math
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot.cameras.opencv import OpenCVCameraConfig
from lerobot.cameras.realsense import RealSenseCameraConfig
from lerobot.common.control_utils import teleop_supports_feedback
from lerobot.robots import make_robot_from_config
from lerobot.teleoperators import make_teleoperator_from_config
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from lerobot_robot_yam.bi_yam_follower import BiYamFollower
from lerobot_robot_yam.config_bi_yam_follower import BiYamFollowerConfig
from lerobot_robot_yam.config_yam_camera import YamSimCameraConfig
from lerobot_robot_yam.config_yam_follower import YamFollowerConfig
from lerobot_robot_yam.errors import ActionError, ConfigError, StaleStateError, YamError
from lerobot_robot_yam.follower_options import FollowerArmConfig
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.yam_follower import YamFollower
from lerobot_teleoperator_yam.bi_yam_leader import BiYamLeader
from lerobot_teleoperator_yam.config_bi_yam_leader import BiYamLeaderConfig
from lerobot_teleoperator_yam.config_yam_leader import YamLeaderConfig
from lerobot_teleoperator_yam.leader_options import LeaderArmConfig

pytestmark = pytest.mark.alone

KEYS = [*(f"joint_{n}.pos" for n in range(1, 7)), "gripper.pos"]
BI_KEYS = [f"{side}_{key}" for side in ("left", "right") for key in KEYS]
STOPS_RAD = [3.25, -3.3]
FIELDS = {"interface": "yam_sim", "gravity_factor": [1.0] * 6}


def follower_config(rig_name, calibration_dir, left=None, right=None, **options):
    def arm(channel, extra):
        fields = {"can_options": {"rig": rig_name}, "gripper_stops_rad": STOPS_RAD, **FIELDS, **(extra or {})}
        return FollowerArmConfig(channel=fields.pop("channel", channel), **fields)

    return BiYamFollowerConfig(
        calibration_dir=calibration_dir,
        left_arm_config=arm("follower_left", left),
        right_arm_config=arm("follower_right", right),
        **options,
    )


def leader_config(rig_name, calibration_dir, **options):
    arms = {
        f"{side}_arm_config": LeaderArmConfig(channel=f"leader_{side}", can_options={"rig": rig_name}, **FIELDS)
        for side in ("left", "right")
    }
    return BiYamLeaderConfig(calibration_dir=calibration_dir, **arms, **options)


def enabled(rig, channel):
    return [motor["enabled"] for motor in rig.state()["arms"][channel]["motors"].values()]


# what is known before anything is connected


def test_bimanual_features_are_in_canonical_order(tmp_path):
    camera = YamSimCameraConfig(camera="top")
    robot = make_robot_from_config(follower_config("none", tmp_path, cameras={"top": camera}))
    assert list(robot.action_features) == BI_KEYS
    assert list(robot.observation_features) == [*BI_KEYS, "top"]
    assert robot.observation_features["top"] == (240, 320, 3)
    assert set(robot.action_features.values()) == {float}
    assert list(robot.cameras) == ["top"]
    assert not robot.is_connected and robot.name == "bi_yam_follower"


@pytest.mark.parametrize(
    "arm, gripper, keys",
    [("yam", "crank_4310", KEYS), ("big_yam", "no_gripper", KEYS[:-1]), ("none", "linear_4310", KEYS[-1:])],
)
def test_single_arm_features(tmp_path, arm, gripper, keys):
    config = YamFollowerConfig(channel="x", arm=arm, gripper=gripper, calibration_dir=tmp_path)
    robot = make_robot_from_config(config)
    assert isinstance(robot, YamFollower)
    assert list(robot.observation_features) == list(robot.action_features) == keys


def test_leader_features_are_the_followers(tmp_path):
    single = make_teleoperator_from_config(YamLeaderConfig(channel="x", calibration_dir=tmp_path))
    both = make_teleoperator_from_config(leader_config("none", tmp_path))
    assert list(single.action_features) == list(single.feedback_features) == KEYS
    assert list(both.action_features) == list(both.feedback_features) == BI_KEYS
    assert teleop_supports_feedback(both) and teleop_supports_feedback(single)


def test_optional_observations_follow_the_positions(tmp_path):
    robot = make_robot_from_config(
        YamFollowerConfig(
            channel="x",
            calibration_dir=tmp_path,
            observe_velocity=True,
            observe_torque=True,
            observe_temperature=True,
        )
    )
    keys = list(robot.observation_features)
    assert keys[:7] == KEYS
    assert [key.rpartition(".")[2] for key in keys[7:]] == [
        kind for kind in ("vel", "torque", "temp_mos", "temp_rotor") for _ in KEYS
    ]
    assert list(robot.action_features) == KEYS


def test_camera_names_and_depth(tmp_path):
    size = {"width": 64, "height": 48, "fps": 30}
    depth = RealSenseCameraConfig(serial_number_or_name="1", use_depth=True, **size)
    config = follower_config("none", tmp_path, left={"cameras": {"wrist": OpenCVCameraConfig(index_or_path=0, **size)}})
    config.cameras = {"top": depth}
    assert list(config.all_cameras()) == ["top", "left_wrist"]
    config.cameras = {}  # a RealSense object needs Intel's library
    robot = BiYamFollower(config)
    assert list(robot.cameras) == ["left_wrist"]
    robot._camera_configs = {"top": depth}
    assert robot.observation_features["top_depth"] == (48, 64, 1)


def test_two_cameras_of_one_name_are_refused(tmp_path):
    camera = YamSimCameraConfig(camera="top")
    config = follower_config("none", tmp_path, left={"cameras": {"wrist": camera}}, cameras={"left_wrist": camera})
    with pytest.raises(ConfigError, match="left_wrist"):
        BiYamFollower(config)


def test_a_camera_without_size_is_refused(tmp_path):
    with pytest.raises(ValueError, match="width"):
        YamFollowerConfig(channel="x", cameras={"c": OpenCVCameraConfig(index_or_path=0)})
    left = {"cameras": {"c": OpenCVCameraConfig(index_or_path=0)}}
    with pytest.raises(ConfigError, match="width"):
        BiYamFollower(follower_config("none", tmp_path, left=left))


def test_our_calibration_never_meets_lerobots(tmp_path):
    """LeRobot loads <id>.json as a dict of MotorCalibration in __init__; ours has another form."""
    robot = make_robot_from_config(YamFollowerConfig(channel="can0", calibration_dir=tmp_path))
    path = Path(robot._arms._configs[0].calibration_path)
    assert path == tmp_path / "yam" / "can0_gripper.json"
    assert not robot.is_calibrated
    path.parent.mkdir()
    path.write_text('{"version": 1}')
    named = YamFollowerConfig(channel="can0", id="blue", calibration_dir=tmp_path)
    assert make_robot_from_config(YamFollowerConfig(channel="can0", calibration_dir=tmp_path)).is_calibrated
    assert not make_robot_from_config(named).is_calibrated


@pytest.mark.parametrize("field, value", [("arm", "yum"), ("gripper", "claw"), ("kp", [1.0]), ("channel", "")])
def test_bad_configs_are_refused_by_name(tmp_path, field, value):
    with pytest.raises(ValueError, match="yum|claw|kp|channel"):
        YamFollower(YamFollowerConfig(**{"channel": "x", "calibration_dir": tmp_path, field: value}))


def test_unconnected_devices_say_so(tmp_path):
    robot = YamFollower(YamFollowerConfig(channel="x", calibration_dir=tmp_path))
    with pytest.raises(DeviceNotConnectedError):
        robot.get_observation()
    with pytest.raises(DeviceNotConnectedError):
        robot.send_action(dict.fromkeys(KEYS, 0.0))
    with pytest.raises(DeviceNotConnectedError):
        robot.calibrate()
    robot.disconnect()  # idempotent, never an error


# connected: one pair for the tests that leave it as they find it


@pytest.fixture(scope="module")
def shared_rig():
    with running_rig() as rig:
        yield rig


@pytest.fixture(scope="module")
def pair(shared_rig, tmp_path_factory):
    directory = tmp_path_factory.mktemp("calibration")
    leader = BiYamLeader(leader_config(shared_rig.name, directory))
    follower = BiYamFollower(follower_config(shared_rig.name, directory))
    leader.connect()
    try:
        follower.connect()
        yield follower, leader
    finally:
        follower.disconnect()
        leader.disconnect()
    assert not any(enabled(shared_rig, "follower_left") + enabled(shared_rig, "leader_right"))


@pytest.fixture
def follower(pair):
    return pair[0]


@pytest.fixture
def leader(pair):
    return pair[1]


def settle(device, action, seconds=1.5):
    """Send the same action at 50 Hz for a while; returns what was last sent."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        sent = device(action)
        time.sleep(0.02)
    return sent


def test_observation_is_as_announced(follower):
    observation = follower.get_observation()
    assert list(observation) == list(follower.observation_features)
    assert all(type(value) is float and math.isfinite(value) for value in observation.values())


def test_connecting_twice_is_refused(follower):
    with pytest.raises(DeviceAlreadyConnectedError):
        follower.connect()


def test_leader_action_fits_the_follower(follower, leader):
    action = leader.get_action()
    assert list(action) == list(follower.action_features)
    assert follower.send_action(action) == pytest.approx(action)  # recorded = sent


def test_targets_are_reached_and_clipped_to_the_limits(follower, shared_rig):
    start = follower.get_observation()
    action = {**start, "left_joint_1.pos": 0.2, "right_gripper.pos": 0.5, "left_joint_2.pos": -1.0}
    sent = settle(follower.send_action, action)
    assert sent["left_joint_2.pos"] == 0.0 and sent["left_joint_1.pos"] == pytest.approx(0.2)
    assert list(sent) == BI_KEYS
    arms = shared_rig.state()["arms"]
    assert arms["follower_left"]["q"][0] == pytest.approx(0.2, abs=0.01)
    assert arms["follower_right"]["opening"] == pytest.approx(0.5, abs=0.03)
    assert follower.get_observation()["left_joint_1.pos"] == pytest.approx(0.2, abs=0.01)


def test_tensors_are_numbers(follower):
    """lerobot-replay sends 0-d torch tensors."""
    action = {key: torch.tensor(value) for key, value in follower.get_observation().items()}
    assert all(type(value) is float for value in follower.send_action(action).values())


@pytest.mark.parametrize(
    "change",
    [
        {"left_joint_1.pos": math.nan},
        {"right_gripper.pos": math.inf},
        {"left_joint_1.pos": "far"},
        {"left_joint_1.pos": None},
        {"left_joint_1.pos": np.zeros(2)},
        {"left_joint_1.pos": torch.zeros(2)},
        {"joint_1.pos": 0.0},
        {"left_joint_3.pos": ...},  # left out
    ],
)
def test_bad_actions_reach_no_arm(follower, change):
    observation = follower.get_observation()
    action = {key: value + 0.3 for key, value in observation.items()} | change
    action = {key: value for key, value in action.items() if value is not ...}
    with pytest.raises(ActionError, match=next(iter(change))):
        follower.send_action(action)
    time.sleep(0.1)
    assert follower.get_observation() == pytest.approx(observation, abs=0.01)


def test_the_trigger_closes_the_gripper_and_silence_keeps_it(leader, shared_rig):
    shared_rig.trigger("leader_left", 0.7)
    time.sleep(0.2)
    assert leader.get_action()["left_gripper.pos"] == pytest.approx(0.3, abs=0.02)
    assert leader.get_action()["right_gripper.pos"] == pytest.approx(1.0, abs=0.02)
    shared_rig.fault("leader_left", None, "handle_silent", True)
    time.sleep(0.5)
    shared_rig.trigger("leader_left", 0.0)
    action = leader.get_action()
    assert action["left_gripper.pos"] == pytest.approx(0.3, abs=0.02)
    assert math.isfinite(action["left_joint_1.pos"])
    shared_rig.clear_faults("leader_left")
    time.sleep(0.3)
    assert leader.get_action()["left_gripper.pos"] == pytest.approx(1.0, abs=0.02)


def test_leader_action_keeps_the_followers_limits(leader, shared_rig):
    """At rest, measured joints 2 and 3 lie on their limits, on either side of them."""
    q = shared_rig.state()["arms"]["leader_left"]["q"]
    shared_rig.hand("leader_left", [0.5], [[q[0], -0.2, *q[2:6]]])  # pull joint 2 into its stop
    seen = []
    for _ in range(50):
        seen.append(leader.get_action()["left_joint_2.pos"])
        time.sleep(0.02)
    shared_rig.release("leader_left")
    assert min(seen) == 0.0


def test_feedback_leads_the_leader_only_while_torque_is_enabled(leader, shared_rig):
    action = leader.get_action()
    goal = {**action, "left_joint_1.pos": action["left_joint_1.pos"] + 0.3}
    settle(leader.send_feedback, goal, 0.5)
    assert leader.get_action()["left_joint_1.pos"] == pytest.approx(action["left_joint_1.pos"], abs=0.05)
    leader.enable_torque()
    with pytest.raises(ActionError):
        leader.send_feedback({"left_joint_1.pos": 0.0})
    settle(leader.send_feedback, goal)
    assert leader.get_action()["left_joint_1.pos"] == pytest.approx(goal["left_joint_1.pos"], abs=0.02)
    leader.disable_torque()
    settle(leader.send_feedback, action, 0.5)
    assert leader.get_action()["left_joint_1.pos"] == pytest.approx(goal["left_joint_1.pos"], abs=0.1)
    assert all(enabled(shared_rig, "leader_left"))  # it floats, it is not limp


def test_a_trigger_takes_over_where_feedback_has_left_the_gripper(leader, shared_rig):
    def opening(trigger):
        shared_rig.trigger("leader_left", trigger)
        return settle(lambda _: leader.get_action(), None, 0.3)["left_gripper.pos"]

    assert opening(0.0) == 1.0
    held = {**leader.get_action(), "left_gripper.pos": 0.4}  # the follower has something in its hand
    leader.enable_torque()
    settle(leader.send_feedback, held, 0.3)
    leader.disable_torque()
    assert opening(0.0) == opening(0.3) == 0.4  # it is not dropped
    assert opening(0.7) == pytest.approx(0.3, abs=0.02)  # picked up
    assert opening(0.0) == 1.0


# connected: what needs a rig of its own


def test_degrees_and_all_observations(rig, tmp_path):
    config = YamFollowerConfig(
        channel="follower_left",
        calibration_dir=tmp_path,
        can_options={"rig": rig.name},
        gripper_stops_rad=STOPS_RAD,
        use_degrees=True,
        observe_velocity=True,
        observe_torque=True,
        observe_temperature=True,
        **FIELDS,
    )
    robot = YamFollower(config)
    robot.connect()
    try:
        observation = robot.get_observation()
        assert list(observation) == list(robot.observation_features)
        action = {key: observation[key] for key in KEYS} | {"joint_1.pos": 15.0, "gripper.pos": 0.5}
        assert settle(robot.send_action, action)["joint_1.pos"] == pytest.approx(15.0)
        truth = rig.state()["arms"]["follower_left"]
        observation = robot.get_observation()
        assert math.degrees(truth["q"][0]) == pytest.approx(15.0, abs=0.6)
        assert observation["joint_1.pos"] == pytest.approx(15.0, abs=0.6)
        assert observation["gripper.pos"] == pytest.approx(0.5, abs=0.03)
        assert 10 < observation["joint_3.temp_mos"] < 80
    finally:
        robot.disconnect()
        robot.disconnect()
    assert not any(enabled(rig, "follower_left"))


def test_calibration_is_stored_and_found_again(rig, tmp_path):
    fields = {"can_options": {"rig": rig.name}, **FIELDS}
    robot = YamFollower(YamFollowerConfig(channel="follower_left", calibration_dir=tmp_path, **fields))
    assert not robot.is_calibrated
    robot.connect()
    try:
        assert robot.is_calibrated
    finally:
        robot.disconnect()
    path = tmp_path / "yam" / "follower_left_gripper.json"
    good = path.read_text()
    path.write_text(good.replace("linear_4310", "crank_4310"))
    with pytest.raises(YamError, match="crank_4310"):
        robot.connect()
    robot.connect(calibrate=False)  # as lerobot-calibrate does: stops that do not fit must not be in its way
    try:
        robot.calibrate()
    finally:
        robot.disconnect()
    assert '"linear_4310"' in path.read_text()


@pytest.mark.parametrize("right_channel, named", [("nowhere", "nowhere"), ("follower_right", "joint_4")])
def test_bimanual_connect_is_all_or_nothing(rig, tmp_path, right_channel, named):
    camera = YamSimCameraConfig(camera="top", rig=rig.name)
    rig.fault("follower_right", "joint_4", "silent")
    right = {"channel": right_channel}
    robot = BiYamFollower(follower_config(rig.name, tmp_path, right=right, cameras={"top": camera}))
    with pytest.raises(YamError, match=named):
        robot.connect()
    assert not robot.is_connected and not robot.cameras["top"].is_connected
    assert not any(enabled(rig, "follower_left") + enabled(rig, "follower_right"))


def test_a_missing_camera_is_noticed_before_anything_is_energised(rig, tmp_path):
    cameras = {name: YamSimCameraConfig(camera=name, rig=rig.name, width=64, height=48) for name in ("top", "attic")}
    robot = BiYamFollower(follower_config(rig.name, tmp_path, cameras=cameras))
    with pytest.raises(ConfigError, match="attic"):
        robot.connect()
    assert not robot.is_connected and not robot.cameras["top"].is_connected
    assert not any(enabled(rig, "follower_left"))


def fresh_image(robot, camera):
    """An image as soon as there is one: a busy machine may take a moment to draw the first ones."""
    deadline = time.monotonic() + 5.0
    while True:
        try:
            return robot.get_observation()[camera]
        except StaleStateError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.05)


def test_a_dead_camera_does_not_keep_the_arms_from_landing(rig, tmp_path):
    camera = YamSimCameraConfig(camera="top", rig=rig.name, width=64, height=48)
    robot = BiYamFollower(follower_config(rig.name, tmp_path, cameras={"top": camera}))
    robot.connect()
    try:
        image = fresh_image(robot, "top")
        assert image.shape == (48, 64, 3) and image.dtype == np.uint8 and image.flags.writeable and image.std() > 5
        robot.cameras["top"].disconnect()
        with pytest.raises(StaleStateError, match="top"):
            robot.get_observation()
        assert robot.is_connected
        assert all(enabled(rig, "follower_left"))
    finally:
        robot.disconnect()
    assert not any(enabled(rig, "follower_left"))
