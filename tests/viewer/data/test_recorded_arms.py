"""The arms that a data set tells of, and the way of an episode as a trajectory."""

import numpy as np
import pytest

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.doctor.kit.targets import from_config
from lerobot_robot_yam.errors import ActionError, ConfigError
from lerobot_robot_yam.face.datasets.check.opened_dataset import ACTION, STATE, OpenedDataset, RecordedEpisode
from lerobot_robot_yam.viewer.data.recorded_arms import followers, motion_of, recorded_arms
from tests.support import seeded_sets as seeds
from tests.support.paths import ROOT


def opened(names=None, robot="bi_yam_follower"):
    """A data set of values with these names, in no files."""
    feature = {"dtype": "float32", "names": names or seeds.names()}
    info = {"fps": 30, "robot_type": robot, "features": {ACTION: feature, STATE: feature}}
    action, state = seeds.motion(0)
    width = len(feature["names"])
    rows = {ACTION: action[:, :width], STATE: state[:, :width], "frame_index": np.arange(len(action))}
    return OpenedDataset(ROOT, info), RecordedEpisode(3, {}, rows, {})


def arms_of(data, known=None, arm="yam"):
    return recorded_arms(data, known or {}, arm, "linear_4310")


def test_two_arms_are_found_by_their_names_and_their_columns_whatever_the_order():
    names = seeds.names()
    data, episode = opened(names[::-1])
    left, right = arms_of(data)
    assert (left.prefix, right.prefix) == ("left_", "right_")
    assert left.hardware.n == right.hardware.n == 7
    backwards = episode.rows[STATE][:, ::-1]
    assert np.array_equal(left.positions(episode, STATE), backwards[:, :7].astype(float))
    assert np.array_equal(right.positions(episode, ACTION), episode.rows[ACTION][:, ::-1][:, 7:].astype(float))


def test_degrees_become_radians_and_openings_stay():
    data, episode = opened(robot="bi_yam_follower_degrees")
    found = arms_of(data)[0].positions(episode, STATE)
    assert np.allclose(found[:, :6], np.radians(episode.rows[STATE][:, :6]))
    assert np.allclose(found[:, 6], episode.rows[STATE][:, 6])


def test_an_arm_without_an_opening_has_no_gripper():
    data, _ = opened([f"joint_{i}.pos" for i in range(1, 7)])
    (arm,) = arms_of(data)
    assert (arm.prefix, arm.hardware.gripper.name, arm.hardware.n) == ("", "no_gripper", 6)


def test_a_run_config_says_what_the_arms_are():
    data, _ = opened()
    known = {"left_": ArmConfig(channel="a", name="mine", arm="yam_ultra")}
    assert [arm.hardware.name for arm in arms_of(data, known)] == ["mine", "right_arm"]


def test_another_number_of_joints_is_refused():
    data, _ = opened([f"joint_{i}.pos" for i in range(1, 6)])
    with pytest.raises(ConfigError, match="the arm has 5 joints"):
        arms_of(data)


def test_poses_of_the_tool_have_no_figure():
    data, _ = opened(["ee_x.pos", "ee_y.pos"])
    assert arms_of(data) == []


def test_an_episode_becomes_one_motion_of_all_arms_at_its_speed():
    data, episode = opened()
    way = motion_of(arms_of(data), ["right_", "left_"], episode, 30, 0.5)
    assert way.seconds == pytest.approx((seeds.FRAMES - 1) / 15)
    assert np.allclose(way.positions[:, :7], episode.rows[ACTION][:, 7:])
    assert np.allclose(way.positions[:, 7:], episode.rows[ACTION][:, :7])
    with pytest.raises(ActionError, match="of the arms left, right, and the run config has left"):
        motion_of(arms_of(data), ["left_"], episode, 30, 0.5)
    episode.rows[ACTION][5, 2] = np.nan
    with pytest.raises(ActionError, match="row 5"):
        motion_of(arms_of(data), ["left_", "right_"], episode, 30, 0.5)


def test_actions_that_are_no_joints_are_not_sent():
    data, episode = opened()
    data.info["features"][ACTION] = {"names": ["ee_x.pos"]}
    with pytest.raises(ConfigError, match="no positions"):
        motion_of(arms_of(data), ["left_", "right_"], episode, 30, 1.0)


def test_the_followers_of_a_run_config_have_the_prefixes_of_data_sets():
    found = followers(from_config(ROOT / "configs/sim/record.yaml", "some-rig"))
    assert {prefix: config.channel for prefix, config in found.items()} == {
        "left_": "follower_left",
        "right_": "follower_right",
    }
    assert all(config.calibration_path for config in found.values())
