"""What a data set or a checkpoint tells of its numbers: joints or tool poses, degrees or radians."""

import json

import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset
from lerobot.utils.feature_utils import hw_to_dataset_features

from lerobot_robot_yam.errors import ActionError
from lerobot_robot_yam.face.datasets.recording import Recording, of_checkpoint, of_dataset, unit_of
from lerobot_robot_yam.face.devices.feature_names import space_of
from lerobot_robot_yam.session.target_limits import refuse_degrees
from tests.policy_plugin.checkpoints import save_scripted
from tests.support.recordings import IS_JOINT, KEYS, robot, write_dataset

named = pytest.mark.parametrize("degrees", [False, True], ids=["radians", "degrees"])


@pytest.mark.parametrize(
    "space, degrees, name",
    [
        ("joint", False, "bi_yam_follower"),
        ("joint", True, "bi_yam_follower_degrees"),
        ("ee", False, "bi_yam_follower_ee"),
        ("ee", True, "bi_yam_follower_ee"),  # whose positions are m and rad all the same
    ],
)
def test_a_data_set_names_the_robot_by_what_it_gives(tmp_path, space, degrees, name):
    root = write_dataset(tmp_path, degrees, space=space)
    assert json.loads((root / "meta" / "info.json").read_text())["robot_type"] == name
    assert name == robot(tmp_path, degrees, space).robot_type
    if space == "joint":
        assert unit_of(of_dataset("local/data", str(root)), IS_JOINT) == ("degrees" if degrees else "radians")


@pytest.mark.parametrize(
    "keys, space", [(KEYS["joint"], "joint"), (KEYS["ee"], "ee"), (["gripper.pos"], None), (["shoulder_pan.pos"], None)]
)
def test_keys_tell_their_space(keys, space):
    assert space_of(keys) == space and space_of(["gripper.pos", *keys]) == space
    assert space_of([*KEYS["joint"], *KEYS["ee"]]) is None


@named
def test_a_data_set_of_another_maker_is_judged_by_its_numbers(tmp_path, degrees):
    root = write_dataset(tmp_path, degrees, robot_type="yam_of_somebody_else")
    assert unit_of(of_dataset("local/data", str(root)), IS_JOINT) == ("degrees" if degrees else "radians")


def test_a_data_set_of_ours_that_is_still_empty_goes_by_its_name(tmp_path):
    features = hw_to_dataset_features(robot(tmp_path, False).action_features, "action")
    data = LeRobotDataset.create("local/data", 30, root=tmp_path / "e", robot_type="yam_follower", features=features)
    data.finalize()
    assert unit_of(of_dataset("local/data", str(tmp_path / "e")), IS_JOINT) == "radians"


def test_a_checkpoint_goes_by_the_name_in_the_data_that_it_was_trained_on_where_these_are_at_hand(tmp_path):
    path = save_scripted(tmp_path / "p", "nothing", arms=2)  # its joints hardly left zero: they may be in either
    assert unit_of(of_checkpoint(str(path), None), IS_JOINT) == "radians"
    root = write_dataset(tmp_path, True)
    (path / "train_config.json").write_text(json.dumps({"dataset": {"repo_id": "local/data", "root": str(root)}}))
    assert unit_of(of_checkpoint(str(path), None), IS_JOINT) == "degrees"


@named
def test_a_checkpoint_tells_by_the_statistics_that_training_has_left_in_it(tmp_path, degrees):
    data = LeRobotDataset("local/data", root=write_dataset(tmp_path, degrees))
    path = save_scripted(tmp_path / "p", "nothing", arms=2, stats=data.meta.stats)
    assert unit_of(of_checkpoint(str(path), None), IS_JOINT) == ("degrees" if degrees else "radians")


@pytest.mark.parametrize("path", ["nobody/nothing", "not a repository", "."])
def test_what_does_not_tell_is_not_guessed(path):
    assert unit_of(of_checkpoint(path, None), IS_JOINT) is None
    assert unit_of(of_dataset(path, None), IS_JOINT) is None


@pytest.mark.parametrize("kind", ["min", "max", "mean", "q01", "q99"])
def test_any_statistic_of_any_joint_will_do_and_a_gripper_will_not(kind):
    values = np.zeros(14)
    for index in range(14):
        values[:] = 0.0
        values[index] = -90.0
        found = unit_of(Recording("data", statistics={"action": {kind: values}}), IS_JOINT)
        assert found == ("degrees" if IS_JOINT[index] else "radians")


def test_relative_actions_are_small_in_either_unit_so_the_state_counts_too():
    state = np.concatenate([np.full(14, 90.0), np.zeros(14)])  # positions, then velocities
    held = {"action": {"max": np.ones(14)}, "observation.state": {"max": state}}
    assert unit_of(Recording("data", statistics=held), IS_JOINT) == "degrees"


def test_statistics_of_something_else_tell_nothing():
    assert unit_of(Recording("data", statistics={"action": {"max": np.full(7, 90.0)}}), IS_JOINT) is None
    assert unit_of(Recording("data"), IS_JOINT) is None


LOWER, UPPER = np.array([-2.6, 0.0, 0.0, -1.7, -1.6, -2.1]), np.array([3.1, 3.7, 3.1, 1.6, 1.6, 2.1])


@pytest.mark.parametrize("q", [[10.0, 60.0, 50.0, -20.0, 5.0, 0.0], [0.0, 45.0, 0.0, 0.0, 0.0, -90.0]])
def test_a_pose_in_degrees_is_refused_and_not_clamped(q):
    with pytest.raises(ActionError, match="use_degrees"):
        refuse_degrees("robot", np.array(q), LOWER, UPPER)


@pytest.mark.parametrize(
    "q",
    [
        [0.0, 60.0, 0.0, 0.0, 0.0, 0.0],  # one wild value
        [1e9, 1e9, 1e9, 1e9, 1e9, 1e9],
        [-60.0, -60.0, 50.0, 0.0, 0.0, 0.0],  # no pose in degrees either
        [4.0, 4.7, 4.1, 2.6, 2.6, 3.1],  # a jump of 1 rad beyond the limits
    ],
)
def test_what_is_no_sign_of_degrees_is_limited_as_ever(q):
    refuse_degrees("robot", np.array(q), LOWER, UPPER)
