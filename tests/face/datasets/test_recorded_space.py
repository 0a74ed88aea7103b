"""Joints or tool poses: data sets and checkpoints tell, and no stock command moves an arm by the wrong ones.

Nothing here can move: there is no rig.
"""

import contextlib
import json
import sys
from functools import partial

import pytest
import torch
from lerobot.scripts import lerobot_record, lerobot_replay, lerobot_rollout

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.devices.cli_check import check_cli
from lerobot_robot_yam.face.devices.feature_names import space_of
from tests.policy_plugin.checkpoints import save_scripted, statistics
from tests.support.recordings import KEYS, NOWHERE, POSE_TOOL, error_of, refused, robot, went_on, write_dataset
from tests.support.tiers import spread

SPACES = ["joint", "ee"]
NAMES = {"joint": "joint positions", "ee": "tool poses"}
in_both = pytest.mark.parametrize("space", SPACES, ids=["joint robot", "ee robot"])
in_poses = pytest.mark.parametrize("space", spread(SPACES, 1), ids=["joint robot", "ee robot"])  # half of them
of_both = pytest.mark.parametrize("recorded", SPACES, ids=["of joints", "of poses"])


@pytest.fixture
def command(tmp_path, monkeypatch):
    return partial(error_of, tmp_path, monkeypatch)


def fits_or_is_refused(error, space, recorded):
    if space == recorded:
        return went_on(error)
    both = f"is of {NAMES[recorded]}, this robot takes {NAMES[space]}"
    return refused(error, both) and f"Set the robot's action_space to {recorded}" in str(error)


def of_poses(arms):
    """Statistics of tool poses, as training leaves them."""
    values = {kind: torch.tensor(POSE_TOOL[: 7 * arms], dtype=torch.float32) for kind in ("min", "max", "mean", "std")}
    return {"action": values, "observation.state": dict(values)}


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
    info = write_dataset(tmp_path, degrees, space=space) / "meta" / "info.json"
    assert json.loads(info.read_text())["robot_type"] == name == robot(tmp_path, degrees, space).robot_type


@pytest.mark.parametrize(
    "keys, space", [(KEYS["joint"], "joint"), (KEYS["ee"], "ee"), (["gripper.pos"], None), (["shoulder_pan.pos"], None)]
)
def test_keys_tell_their_space(keys, space):
    assert space_of(keys) == space and space_of(["gripper.pos", *keys]) == space
    assert space_of([*KEYS["joint"], *KEYS["ee"]]) is None


# data sets


@in_both
@of_both
def test_replay(command, tmp_path, space, recorded):
    dataset = {"repo_id": "local/data", "root": str(write_dataset(tmp_path, space=recorded)), "episode": 0}
    error = command(lerobot_replay.main, {"robot": {"action_space": space}, "dataset": dataset})
    assert fits_or_is_refused(error, space, recorded)


@in_poses
@of_both
def test_resuming_a_rollout(command, tmp_path, space, recorded):
    path = save_scripted(tmp_path / "p", "nothing", arms=2, action_feature_names=KEYS[space])
    dataset = {"repo_id": "local/rollout_data", "root": str(write_dataset(tmp_path, space=recorded))}
    document = {"robot": {"action_space": space}, "dataset": dataset | {"push_to_hub": False}, "resume": True}
    error = command(lerobot_rollout.main, document | {"strategy": {"type": "sentry"}}, f"--policy.path={path}")
    assert fits_or_is_refused(error, space, recorded)


@pytest.mark.parametrize("resume", ["True", "yes", "on"])
def test_resuming_in_any_of_the_parsers_words(command, tmp_path, resume):
    path = save_scripted(tmp_path / "p", "nothing", arms=2, action_feature_names=KEYS["joint"])
    dataset = {"repo_id": "local/rollout_data", "root": str(write_dataset(tmp_path, space="ee")), "push_to_hub": False}
    document = {"dataset": dataset, "strategy": {"type": "sentry"}}
    error = command(lerobot_rollout.main, document, f"--policy.path={path}", f"--resume={resume}")
    assert fits_or_is_refused(error, "joint", "ee")


@in_poses
@of_both
def test_resuming_a_recording(command, tmp_path, space, recorded):
    dataset = {"repo_id": "local/data", "root": str(write_dataset(tmp_path, space=recorded)), "push_to_hub": False}
    document = {"robot": {"action_space": space}, "dataset": dataset | {"single_task": "none"}, "resume": True}
    document["teleop"] = {"type": "bi_yam_leader", "action_space": space}
    document["teleop"] |= {f"{side}_arm_config": {**NOWHERE, "channel": f"l_{side}"} for side in ("left", "right")}
    error = command(lerobot_record.main, document)
    assert fits_or_is_refused(error, space, recorded)


def test_a_data_set_of_another_gripper_is_not_replayed(command, tmp_path):
    dataset = {"repo_id": "local/data", "root": str(write_dataset(tmp_path)), "episode": 0}
    right = {**NOWHERE, "channel": "right", "gripper": "no_gripper"}
    error = command(lerobot_replay.main, {"robot": {"right_arm_config": right}, "dataset": dataset})
    assert refused(error, "has other actions than this robot, they differ in right_gripper.pos")


def test_another_order_can_be_replayed_but_not_continued(command, tmp_path):
    root = write_dataset(tmp_path)
    info = root / "meta" / "info.json"
    document = json.loads(info.read_text())
    document["features"]["action"]["names"].reverse()
    info.write_text(json.dumps(document))
    dataset = {"repo_id": "local/rollout_data", "root": str(root)}
    assert went_on(command(lerobot_replay.main, {"dataset": dataset | {"episode": 0}}))
    path = save_scripted(tmp_path / "p", "nothing", arms=2)
    document = {"dataset": dataset | {"push_to_hub": False}, "strategy": {"type": "sentry"}, "resume": True}
    assert refused(command(lerobot_rollout.main, document, f"--policy.path={path}"), "differ in their order")


# checkpoints


@in_poses
@of_both
def test_rollout_of_a_policy_that_names_its_actions(command, tmp_path, space, recorded):
    path = save_scripted(tmp_path / "p", "nothing", arms=2, stats=of_poses(2), action_feature_names=KEYS[recorded])
    error = command(lerobot_rollout.main, {"robot": {"action_space": space}, "policy": {"path": str(path)}})
    assert fits_or_is_refused(error, space, recorded)


@in_poses
@of_both
def test_rollout_of_a_policy_whose_training_data_are_at_hand(command, tmp_path, space, recorded):
    path = save_scripted(tmp_path / "p", "nothing", arms=2, stats=of_poses(2))
    trained = {"dataset": {"repo_id": "local/data", "root": str(write_dataset(tmp_path, space=recorded))}}
    (path / "train_config.json").write_text(json.dumps(trained))
    error = command(lerobot_rollout.main, {"robot": {"action_space": space}, "policy": {"path": str(path)}})
    assert fits_or_is_refused(error, space, recorded)


def test_a_policy_that_has_learnt_another_order_is_not_rolled_out(command, tmp_path):
    path = save_scripted(tmp_path / "p", "nothing", arms=2, action_feature_names=KEYS["joint"][7:] + KEYS["joint"][:7])
    error = command(lerobot_rollout.main, {"policy": {"path": str(path)}})
    assert refused(error, "differ in their order") and "train a policy anew" in str(error)


@pytest.mark.parametrize("degrees", [False, True], ids=["radians", "degrees"])
def test_what_no_tool_reaches_are_joints(command, tmp_path, degrees):
    path = save_scripted(tmp_path / "p", "nothing", arms=2, stats=statistics(2, degrees))
    error = command(lerobot_rollout.main, {"robot": {"action_space": "ee"}, "policy": {"path": str(path)}})
    assert fits_or_is_refused(error, "ee", "joint")


@in_both
@pytest.mark.parametrize("trained", [None, {}, {"repo_id": "local/elsewhere", "root": None}])
def test_a_checkpoint_that_does_not_tell_is_warned_of(tmp_path, monkeypatch, caplog, space, trained):
    path = save_scripted(tmp_path / "p", "nothing", arms=2, stats=of_poses(2))
    if trained is not None:
        (path / "train_config.json").write_text(json.dumps({"dataset": trained}))
    monkeypatch.setattr(sys, "argv", ["lerobot-rollout", f"--policy.path={path}"])
    check_cli("robot", KEYS[space], False)
    assert f"{path} does not tell joints from tool poses; this robot takes {NAMES[space]}" in caplog.text


# policies on an openpi server


@pytest.mark.parametrize(
    "arguments, space, refusal",
    [
        ([], "joint", None),
        ([], "ee", "policy.action_space=joint_position is of joint positions, this robot takes tool poses"),
        (["--policy.action_space=cartesian_position"], "ee", None),
        (["--policy.action_space=cartesian_position"], "joint", "of tool poses, this robot takes joint positions"),
        (["--policy.action_space=cartesian_position", "--policy.angle_unit=deg"], "ee", "policy.angle_unit to rad"),
    ],
)
def test_an_openpi_server_speaks_the_robots_space(monkeypatch, arguments, space, refusal):
    monkeypatch.setattr(sys, "argv", ["lerobot-rollout", "--policy.type=yam_openpi", *arguments])
    with pytest.raises(ConfigError, match=refusal) if refusal else contextlib.nullcontext():
        check_cli("robot", KEYS[space], False)


def test_a_saved_openpi_policy_is_no_exception(monkeypatch, tmp_path):
    (tmp_path / "config.json").write_text('{"type": "yam_openpi", "action_space": "cartesian_position"}')
    monkeypatch.setattr(sys, "argv", ["lerobot-rollout", f"--policy.path={tmp_path}"])
    check_cli("robot", KEYS["ee"], False)
    with pytest.raises(ConfigError, match="of tool poses, this robot takes joint positions"):
        check_cli("robot", KEYS["joint"], False)


def test_what_no_arm_can_be_driven_by_cannot_be_asked_for(command, capsys):
    command(lerobot_rollout.main, {}, "--policy.type=yam_openpi", "--policy.action_space=joint_velocity")
    assert "invalid choice: 'joint_velocity'" in capsys.readouterr().err
