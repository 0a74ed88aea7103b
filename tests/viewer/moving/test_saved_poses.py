"""The file of saved poses."""

import json

import numpy as np
import pytest

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.errors import ActionError, ConfigError
from lerobot_robot_yam.viewer.moving.saved_poses import SavedPoses

ARM = ResolvedArm(ArmConfig(channel="can0", name="left"))
OTHER = ResolvedArm(ArmConfig(channel="can1", name="right"))
POSE = np.array([0.1, 0.5, 0.6, -0.2, 0.3, 0.4, 0.75])
ROW = {"arm": "yam", "gripper": "linear_4310", "q_rad": [0.1, 0.5, 0.6, -0.2, 0.3, 0.4], "opening": 0.75}


def written(path, **changes):
    path.write_text(json.dumps({"poses": {"up": {"left": {**ROW, **changes}}}}))
    return path


def test_a_pose_comes_back_from_its_file(tmp_path):
    path = tmp_path / "not there yet" / "rig.poses.json"
    SavedPoses(path, [ARM]).save(" up ", {"left": POSE})
    poses = SavedPoses(path, [ARM])
    assert poses.names == ["up"]
    np.testing.assert_allclose(poses["up"]["left"], POSE, atol=1e-4)


def test_poses_of_other_arms_stay_in_the_file_and_are_not_offered(tmp_path):
    path = tmp_path / "poses.json"
    SavedPoses(path, [OTHER]).save("up", {"right": POSE})
    SavedPoses(path, [OTHER]).save("aside", {"right": POSE})
    poses = SavedPoses(path, [ARM])
    assert poses.names == []
    poses.save("up", {"left": POSE})
    assert SavedPoses(path, [ARM, OTHER]).names == ["up", "aside"]
    assert set(SavedPoses(path, [ARM, OTHER])["up"]) == {"left", "right"}


def test_a_forgotten_pose_is_gone(tmp_path):
    path = written(tmp_path / "poses.json")
    SavedPoses(path, [ARM]).forget("up")
    poses = SavedPoses(path, [ARM])
    assert poses.names == []
    with pytest.raises(ActionError, match="no saved pose 'up'"):
        poses["up"]


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"q_rad": [0.1, 0.5]}, "must have shape"),
        ({"q_rad": [9.0, 0.5, 0.6, 0.0, 0.0, 0.0]}, "joint_1 at 9.000 is beyond its limits"),
        ({"q_rad": "up"}, "must be 6 numbers"),
        ({"q_rad": [float("nan"), 0.5, 0.6, 0.0, 0.0, 0.0]}, "is nan"),
        ({"opening": None}, "opening is not a number"),
        ({"opening": 2.0}, "gripper at 2.000 is beyond"),
        ({"gripper": "crank_4310"}, "no pose of yam with linear_4310"),
    ],
)
def test_what_is_no_pose_of_the_arm_is_refused_when_the_file_is_read(tmp_path, changes, words):
    path = written(tmp_path / "poses.json", **changes)
    with pytest.raises(ConfigError, match=words) as refused:
        SavedPoses(path, [ARM])
    assert str(path) in str(refused.value)


@pytest.mark.parametrize("text", ["", "[]", '{"poses": []}', '{"poses": {"up": 3}}', "[" * 100000, "\0"])
def test_what_is_no_file_of_poses_is_refused(tmp_path, text):
    path = tmp_path / "poses.json"
    path.write_text(text)
    with pytest.raises(ConfigError, match="saved poses"):
        SavedPoses(path, [ARM])


@pytest.mark.parametrize("name", ["", "  ", "x" * 61, "a\nb"])
def test_a_name_that_cannot_be_shown_is_refused(tmp_path, name):
    poses = SavedPoses(tmp_path / "poses.json", [ARM])
    with pytest.raises(ActionError, match="name"):
        poses.save(name, {"left": POSE})
    assert poses.names == [] and not poses.path.exists()
