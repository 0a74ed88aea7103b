"""No stock command moves an arm by numbers of another meaning: joints or tool poses, radians or degrees.

Nothing here can move: there is no rig. `tests/cli/test_rollout.py` looks at one.
"""

import contextlib
import itertools
import json
import sys

import pytest
import torch
from lerobot.scripts import lerobot_record, lerobot_replay, lerobot_rollout

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.lerobot_command.command_checks import check_cli
from tests.policy_plugin.checkpoints import save_scripted, statistics
from tests.support.lerobot_calls import while_parsing
from tests.support.recordings import KEYS, NOWHERE, POSE_TOOL, error_of, refused, went_on, write_dataset
from tests.support.tiers import spread

NAMES = {"joint": "joint positions", "ee": "tool poses"}
MEANINGS = {"radians": ("joint", False), "degrees": ("joint", True), "poses": ("ee", False)}
BOTH = list(itertools.product(MEANINGS, MEANINGS))


def says(robot, recorded):
    """What the refusal of a recording of that meaning says to a robot of another one; None of the same."""
    ours, theirs = MEANINGS[robot][0], MEANINGS[recorded][0]
    if ours != theirs:
        return f"is of {NAMES[theirs]}, this robot takes {NAMES[ours]}"
    return None if robot == recorded else f"is in {recorded}, this robot in {robot}"


def dataset_of(tmp_path, meaning):
    """Options of a data set whose numbers mean that."""
    space, degrees = MEANINGS[meaning]
    return {"repo_id": "local/rollout_data", "root": str(write_dataset(tmp_path, degrees, space=space))}


def of_poses(arms):
    """Statistics of tool poses, as training leaves them."""
    values = {kind: torch.tensor(POSE_TOOL[: 7 * arms], dtype=torch.float32) for kind in ("min", "max", "mean", "std")}
    return {"action": values, "observation.state": dict(values)}


def checkpoint_of(tmp_path, meaning):
    """A checkpoint whose numbers mean that: statistics tell degrees, names of values tell poses."""
    space, degrees = MEANINGS[meaning]
    if space == "joint":
        return save_scripted(tmp_path / "p", "nothing", arms=2, stats=statistics(2, degrees))
    return save_scripted(tmp_path / "p", "nothing", arms=2, stats=of_poses(2), action_feature_names=KEYS[space])


# stock commands


def replay(tmp_path, robot, recorded):
    return lerobot_replay.main, {"dataset": dataset_of(tmp_path, recorded) | {"episode": 0}}


def rollout(tmp_path, robot, recorded):
    return lerobot_rollout.main, {"policy": {"path": str(checkpoint_of(tmp_path, recorded))}}


def resumed_rollout(tmp_path, robot, recorded):
    data = dataset_of(tmp_path, recorded) | {"push_to_hub": False}
    policy = {"path": str(checkpoint_of(tmp_path, robot))}
    return lerobot_rollout.main, {"dataset": data, "policy": policy, "strategy": {"type": "sentry"}, "resume": True}


def resumed_recording(tmp_path, robot, recorded):
    space, degrees = MEANINGS[robot]
    teleop = {"type": "bi_yam_leader", "use_degrees": degrees, "action_space": space}
    teleop |= {f"{side}_arm_config": {**NOWHERE, "channel": f"l_{side}"} for side in ("left", "right")}
    data = dataset_of(tmp_path, recorded) | {"push_to_hub": False, "single_task": "none"}
    return lerobot_record.main, {"dataset": data, "teleop": teleop, "resume": True}


@pytest.mark.parametrize(("robot", "recorded"), spread(BOTH, 0, 1))
@pytest.mark.parametrize("command", spread([replay, rollout, resumed_rollout, resumed_recording], 0, 1, 3))
def test_a_stock_command(tmp_path, monkeypatch, command, robot, recorded):
    space, degrees = MEANINGS[robot]
    main, document = command(tmp_path, robot, recorded)
    document["robot"] = {"use_degrees": degrees, "action_space": space}
    error, refusal = error_of(tmp_path, monkeypatch, main, document), says(robot, recorded)
    assert refused(error, refusal) if refusal else went_on(error)


# the check alone


@pytest.fixture
def check(monkeypatch):
    """Checks a command's options as a robot of that meaning does, and compares the refusal, None for none."""

    def look(meaning, refusal, command, path=None, keys=None, words=(), **options):
        space, degrees = MEANINGS[meaning]
        monkeypatch.setattr(sys, "argv", [command, *([f"--policy.path={path}"] if path else []), *words])
        with pytest.raises(ConfigError, match=refusal) if refusal else contextlib.nullcontext():
            while_parsing(lambda: check_cli("robot", keys or KEYS[space], degrees), **options)

    return look


@pytest.mark.parametrize(("robot", "recorded"), BOTH)
def test_a_data_set_and_a_checkpoint(check, tmp_path, robot, recorded):
    data, path = dataset_of(tmp_path, recorded), checkpoint_of(tmp_path, recorded)
    check(robot, says(robot, recorded), "lerobot-replay", dataset=data | {"episode": 0})
    check(robot, says(robot, recorded), "lerobot-rollout", path)
    check(robot, says(robot, recorded), "robot_client", pretrained_name_or_path=str(path))


@pytest.mark.parametrize("resume", [True, "true"])
def test_resuming_in_any_of_the_parsers_words(check, tmp_path, resume):
    data = dataset_of(tmp_path, "poses")
    check("radians", says("radians", "poses"), "lerobot-record", dataset=data, resume=resume)


def test_a_data_set_of_another_gripper_is_not_replayed(check, tmp_path):
    data = dataset_of(tmp_path, "radians") | {"episode": 0}
    refusal = "has other actions than this robot, they differ in right_gripper.pos; nothing was energised"
    check("radians", refusal, "lerobot-replay", keys=KEYS["joint"][:-1], dataset=data)


def test_another_order_can_be_replayed_but_not_continued_or_rolled_out(check, tmp_path):
    data, other = dataset_of(tmp_path, "radians"), KEYS["joint"][7:] + KEYS["joint"][:7]
    check("radians", None, "lerobot-replay", keys=other, dataset=data | {"episode": 0})
    check("radians", "differ in their order", "lerobot-record", keys=other, dataset=data, resume=True)
    path = save_scripted(tmp_path / "p", "nothing", arms=2, action_feature_names=KEYS["joint"])
    check("radians", "their order.*train a policy anew", "lerobot-rollout", path, keys=other)


@pytest.mark.parametrize("recorded", ["radians", "poses"])
def test_the_training_data_of_a_policy_tell_where_they_are_at_hand(check, tmp_path, recorded):
    path = save_scripted(tmp_path / "p", "nothing", arms=2, stats=of_poses(2))
    (path / "train_config.json").write_text(json.dumps({"dataset": dataset_of(tmp_path, recorded)}))
    for robot in ("radians", "poses"):
        check(robot, says(robot, recorded), "lerobot-rollout", path)


@pytest.mark.parametrize("degrees", [False, True], ids=["radians", "degrees"])
def test_what_no_tool_reaches_are_joints(check, tmp_path, degrees):
    path = save_scripted(tmp_path / "p", "nothing", arms=2, stats=statistics(2, degrees))
    check("poses", says("poses", "radians"), "lerobot-rollout", path)


@pytest.mark.parametrize("meaning", ["radians", "poses"])
@pytest.mark.parametrize("trained", [None, {}, {"repo_id": "local/elsewhere", "root": None}])
def test_a_checkpoint_that_does_not_tell_is_warned_of(check, tmp_path, caplog, meaning, trained):
    path = save_scripted(tmp_path / "p", "nothing", arms=2, stats=of_poses(2))
    if trained is not None:
        (path / "train_config.json").write_text(json.dumps({"dataset": trained}))
    check(meaning, None, "lerobot-rollout", path)
    takes = NAMES[MEANINGS[meaning][0]]
    assert f"{path} does not tell joints from tool poses; this robot takes {takes}" in caplog.text


@pytest.mark.parametrize(
    "options, meaning, refusal",
    [
        ({}, "radians", None),
        ({}, "poses", "policy.action_space=joint_position is of joint positions, this robot takes tool poses"),
        ({"action_space": "cartesian_position"}, "poses", None),
        ({"action_space": "cartesian_position"}, "radians", "of tool poses, this robot takes joint positions"),
        ({"action_space": "cartesian_position", "angle_unit": "deg"}, "poses", "policy.angle_unit to rad"),
        ({"angle_unit": "deg"}, "degrees", None),
        ({"angle_unit": "deg"}, "radians", "policy.angle_unit is in degrees"),
        ({"angle_unit": "rad"}, "degrees", "policy.angle_unit is in radians"),
    ],
)
def test_an_openpi_server_speaks_as_the_robot_does(check, tmp_path, options, meaning, refusal):
    check(meaning, refusal, "lerobot-rollout", policy={"type": "yam_openpi"} | options)
    (tmp_path / "config.json").write_text(json.dumps({"type": "yam_openpi"} | options))
    check(meaning, refusal, "lerobot-rollout", tmp_path)
    (tmp_path / "config.json").write_text('{"type": "yam_openpi"}')
    words = [f"--policy.{name}={value}" for name, value in options.items()]
    check(meaning, refusal, "lerobot-rollout", tmp_path, words=words)


def test_what_no_arm_can_be_driven_by_cannot_be_asked_for(tmp_path, monkeypatch, capsys):
    words = "--policy.type=yam_openpi", "--policy.action_space=joint_velocity"
    error_of(tmp_path, monkeypatch, lerobot_rollout.main, {}, *words)
    assert "invalid choice: 'joint_velocity'" in capsys.readouterr().err


@pytest.mark.parametrize("dataset", ["x", None, {"episode": 0}, {"root": "local/nothing", "episode": "first"}])
def test_what_lerobot_refuses_is_left_to_it(check, dataset):
    check("radians", dataset and "root" in dataset and "no data set", "lerobot-replay", dataset=dataset)


@pytest.mark.parametrize(
    ("program", "refuses"), [("/bin/lerobot-train", False), ("x/lerobot_train.py", False), ("lerobot-eval", True)]
)
def test_the_checkpoint_from_which_a_training_begins_moves_nothing(check, tmp_path, program, refuses):
    path = save_scripted(tmp_path / "p", "nothing", arms=2, stats=statistics(2, degrees=True))
    check("radians", "is in degrees" if refuses else None, program, path)


def test_an_unknown_unit_is_said(check, caplog):
    check("degrees", None, "lerobot-rollout", "nobody/nothing")
    assert "nobody/nothing does not tell its unit; this robot is in degrees" in caplog.text


@pytest.mark.parametrize("words", [[], ["script.py", "--policy.action_space=x"], [""]])
def test_a_script_of_ones_own_is_not_looked_at(monkeypatch, caplog, words):
    monkeypatch.setattr(sys, "argv", words)
    check_cli("robot", KEYS["joint"], False)
    assert not [record for record in caplog.records if record.name.startswith("lerobot_robot_yam")]
