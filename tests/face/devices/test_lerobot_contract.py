"""Promises that LeRobot's loops rely on, asked of the real devices on a virtual rig."""

import contextlib
import math
from pathlib import Path

import numpy as np
import pytest
from lerobot.cameras.opencv import OpenCVCameraConfig
from lerobot.cameras.realsense import RealSenseCameraConfig
from lerobot.common.control_utils import teleop_supports_feedback
from lerobot.robots import make_robot_from_config
from lerobot.teleoperators import make_teleoperator_from_config
from lerobot.utils.errors import DeviceNotConnectedError

from lerobot_robot_yam.config_yam_camera import YamSimCameraConfig
from lerobot_robot_yam.config_yam_follower import BiYamFollowerConfig, FollowerArmConfig, YamFollowerConfig
from lerobot_robot_yam.errors import ConfigError, StaleStateError, YamError
from lerobot_robot_yam.system.clock import SYSTEM
from lerobot_robot_yam.yam_follower import BiYamFollower, YamFollower
from lerobot_teleoperator_yam.config_yam_leader import BiYamLeaderConfig, YamLeaderConfig
from lerobot_teleoperator_yam.leader_options import LeaderArmConfig
from lerobot_teleoperator_yam.yam_leader import BiYamLeader, YamLeader
from tests.support.in_step import Together
from tests.support.rigged import rig_of

KEYS = [*(f"joint_{n}.pos" for n in range(1, 7)), "gripper.pos"]
BI_KEYS = [f"{side}_{key}" for side in ("left", "right") for key in KEYS]
STOPS_RAD = [3.25, -3.3]
FIELDS = {"interface": "yam_sim", "gravity_factor": [1.0] * 6}


def on_rig(rig_name, **fields):
    """Fields of an arm on the rig of that name, live or in lock-step; and the options of its device."""
    in_step = rig_name.startswith("lockstep")
    fields = {**FIELDS, "can_options": {"rig": rig_name}} | fields
    return fields | ({"interface": "yam_lockstep"} if in_step else {}), {"isolation": Together} if in_step else {}


def follower_config(rig_name, calibration_dir, left=None, right=None, **options):
    def arm(channel, extra):
        fields, more = on_rig(rig_name, **{"channel": channel, "gripper_stops_rad": STOPS_RAD} | (extra or {}))
        options.update(more)
        return FollowerArmConfig(**fields)

    arms = {"left_arm_config": arm("follower_left", left), "right_arm_config": arm("follower_right", right)}
    return BiYamFollowerConfig(calibration_dir=calibration_dir, **arms, **options)


def leader_config(rig_name, calibration_dir, **options):
    arms = {}
    for side in ("left", "right"):
        fields, more = on_rig(rig_name, channel=f"leader_{side}")
        arms[f"{side}_arm_config"] = LeaderArmConfig(**fields)
    return BiYamLeaderConfig(calibration_dir=calibration_dir, **arms, **more | options)


@contextlib.contextmanager
def connected_pair(rig, calibration_dir, **options):
    """A bimanual follower and its leader, with the same options."""
    follower = BiYamFollower(follower_config(rig.name, calibration_dir, **options))
    leader = BiYamLeader(leader_config(rig.name, calibration_dir, **options))
    leader.connect()
    try:
        follower.connect()
        yield follower, leader
    finally:
        leave(follower)
        leave(leader)


def leave(device):
    """Land it; in lock-step its world just ends."""
    if isinstance(device._arms._session._runner, Together):
        device._arms.discard()
    device.disconnect()


def enabled(rig, channel):
    return [motor["enabled"] for motor in rig.state()["arms"][channel]["motors"].values()]


def settle(device, action, seconds=1.5, clock=SYSTEM):
    """Send the same action at 50 Hz for a while; returns what was last sent."""
    deadline = clock.now() + seconds
    while clock.now() < deadline:
        sent = device(action)
        clock.sleep(0.02)
    return sent


# what is known before anything is connected


def test_a_leader_has_no_gripper_key_for_a_follower_without_a_gripper(tmp_path):
    follower = YamFollower(YamFollowerConfig(channel="x", gripper="no_gripper", calibration_dir=tmp_path))
    leader = YamLeader(YamLeaderConfig(channel="y", ee_gripper="no_gripper", calibration_dir=tmp_path))
    assert list(leader.action_features) == list(follower.action_features) == KEYS[:-1]


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
    assert config.image_names() == ["top", "top_depth", "left_wrist"]
    config.cameras = {}  # a RealSense object needs Intel's library
    robot = BiYamFollower(config)
    assert list(robot.cameras) == ["left_wrist"]
    robot._camera_configs = {"top": depth}
    assert robot.observation_features["top_depth"] == (48, 64, 1)


def test_two_cameras_of_one_name_and_one_without_size_are_refused(tmp_path):
    camera = YamSimCameraConfig(camera="top")
    with pytest.raises(ConfigError, match="left_wrist"):
        follower_config("none", tmp_path, left={"cameras": {"wrist": camera}}, cameras={"left_wrist": camera})
    sizeless = {"cameras": {"c": OpenCVCameraConfig(index_or_path=0)}}
    with pytest.raises(ConfigError, match="width"):
        YamFollowerConfig(channel="x", **sizeless)
    with pytest.raises(ConfigError, match="width"):
        BiYamFollower(follower_config("none", tmp_path, left=sizeless))


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


@pytest.mark.parametrize(
    "field, value, named",
    [("arm", "yum", "yum"), ("gripper", "claw", "claw"), ("kp", [1.0], "kp"), ("channel", "", "channel")]
    + [(key, None, f"{key} takes") for key in ("use_degrees", "observe_torque", "hold_integral")],
)
def test_bad_configs_are_refused_by_name(tmp_path, field, value, named):
    with pytest.raises(ConfigError, match=named):
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


# connected: what needs a rig of its own


@pytest.fixture
def rig():
    with rig_of("lockstep") as rig:
        yield rig


def test_degrees_and_all_observations(rig, tmp_path):
    fields, options = on_rig(rig.name, channel="follower_left", gripper_stops_rad=STOPS_RAD)
    options |= {"use_degrees": True, "observe_velocity": True, "observe_torque": True, "observe_temperature": True}
    robot = YamFollower(YamFollowerConfig(calibration_dir=tmp_path, **fields, **options))
    robot.connect()
    try:
        observation = robot.get_observation()
        assert list(observation) == list(robot.observation_features)
        action = {key: observation[key] for key in KEYS} | {"joint_1.pos": 15.0, "gripper.pos": 0.5}
        assert settle(robot.send_action, action, clock=robot.clock)["joint_1.pos"] == pytest.approx(15.0)
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


@pytest.mark.long
def test_calibration_is_stored_and_found_again(rig, tmp_path):
    fields, options = on_rig(rig.name, channel="follower_left")
    robot = YamFollower(YamFollowerConfig(calibration_dir=tmp_path, **fields, **options))
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
    path.write_text(good)
    robot.connect(calibrate=False)  # what is known is used
    try:
        assert robot.send_action({key: robot.get_observation()[key] for key in robot.action_features})
    finally:
        robot.disconnect()
    path.write_text(good.replace("linear_4310", "crank_4310"))
    robot.connect(calibrate=False)  # as lerobot-calibrate does: stops that do not fit must not be in its way
    try:
        robot.calibrate()
    finally:
        robot.disconnect()
    assert '"linear_4310"' in path.read_text()


@pytest.mark.parametrize(
    "right_channel, camera, named",
    [("nowhere", "front", "nowhere"), ("follower_right", "front", "joint_4"), ("follower_right", "attic", "attic")],
)
def test_connect_is_all_or_nothing(rig, tmp_path, right_channel, camera, named):
    cameras = {name: YamSimCameraConfig(camera=name, rig=rig.name, width=64, height=48) for name in ("top", camera)}
    rig.fault("follower_right", "joint_4", "silent")
    robot = BiYamFollower(follower_config(rig.name, tmp_path, right={"channel": right_channel}, cameras=cameras))
    with pytest.raises(YamError, match=named):
        robot.connect()
    assert not robot.is_connected and not robot.cameras["top"].is_connected
    assert not any(enabled(rig, "follower_left") + enabled(rig, "follower_right"))


def test_cameras_of_virtual_arms_look_at_the_arms_rig(tmp_path):
    arms = {"interface": "yam_sim", "can_options": {"rig": "bench", "scene": "drawer", "seed": 3, "bitrate": 1000000}}
    cameras = {"top": YamSimCameraConfig(camera="top"), "other": YamSimCameraConfig(camera="top", rig="elsewhere")}
    config = YamFollowerConfig(channel="follower_left", calibration_dir=tmp_path, cameras=cameras, **arms)
    top, other = (YamFollower(config).cameras[name].config for name in ("top", "other"))
    assert (top.rig, top.scene, top.rig_options) == ("bench", "drawer", {"seed": 3})
    assert (other.rig, other.scene, other.rig_options) == ("elsewhere", None, {})
    assert cameras["top"].rig == "auto"  # what the user has given stays as it is


def test_a_dead_camera_does_not_keep_the_arms_from_landing(rig, tmp_path):
    camera = YamSimCameraConfig(camera="top", rig=rig.name, width=64, height=48)
    robot = BiYamFollower(follower_config(rig.name, tmp_path, cameras={"top": camera}))
    robot.connect()
    try:
        image = robot.get_observation()["top"]
        assert image.shape == (48, 64, 3) and image.dtype == np.uint8 and image.flags.writeable and image.std() > 5
        robot.cameras["top"].disconnect()
        with pytest.raises(StaleStateError, match="top"):
            robot.get_observation()
        assert robot.is_connected
        assert all(enabled(rig, "follower_left"))
    finally:
        robot.disconnect()
    assert not any(enabled(rig, "follower_left"))
