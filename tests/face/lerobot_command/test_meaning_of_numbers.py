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
from tests.cli.conftest import ROOT
from tests.policy_plugin.checkpoints import save_scripted, statistics
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
@pytest.mark.parametrize("command", [replay, rollout, resumed_rollout, resumed_recording])
def test_a_stock_command(tmp_path, monkeypatch, command, robot, recorded):
    space, degrees = MEANINGS[robot]
    main, document = command(tmp_path, robot, recorded)
    document["robot"] = {"use_degrees": degrees, "action_space": space}
    error, refusal = error_of(tmp_path, monkeypatch, main, document), says(robot, recorded)
    assert refused(error, refusal) if refusal else went_on(error)


# the check alone


@pytest.fixture
def check(monkeypatch):
    """Looks at a command line as a robot of that meaning does, and compares the refusal, None for none."""

    def look(meaning, refusal, *words, keys=None):
        space, degrees = MEANINGS[meaning]
        monkeypatch.setattr(sys, "argv", [str(word) for word in words])
        with pytest.raises(ConfigError, match=refusal) if refusal else contextlib.nullcontext():
            check_cli("robot", keys or KEYS[space], degrees)

    return look


def words_of(dataset, *more):
    return [*(f"--dataset.{name}={value}" for name, value in dataset.items()), *more]


@pytest.mark.parametrize(("robot", "recorded"), BOTH)
def test_a_data_set_and_a_checkpoint(check, tmp_path, robot, recorded):
    check(
        robot, says(robot, recorded), "lerobot-replay", *words_of(dataset_of(tmp_path, recorded)), "--dataset.episode=0"
    )
    check(robot, says(robot, recorded), "lerobot-rollout", f"--policy.path={checkpoint_of(tmp_path, recorded)}")


def test_the_command_line_counts_above_the_file(check, tmp_path):
    file, line = dataset_of(tmp_path, "degrees") | {"episode": 0}, dataset_of(tmp_path, "radians")
    (tmp_path / "run.yaml").write_text(json.dumps({"dataset": file}))
    check("degrees", None, "lerobot-replay", f"--config_path={tmp_path}/run.yaml")
    words = f"--config_path={tmp_path}/run.yaml", f"--dataset.root={line['root']}"
    check("degrees", "is in radians", "lerobot-replay", *words)


@pytest.mark.parametrize("resume", ["True", "yes", "on"])
def test_resuming_in_any_of_the_parsers_words(check, tmp_path, resume):
    words = words_of(dataset_of(tmp_path, "poses"), f"--resume={resume}")
    check("radians", says("radians", "poses"), "lerobot-record", *words)


def test_a_data_set_of_another_gripper_is_not_replayed(check, tmp_path):
    words = words_of(dataset_of(tmp_path, "radians"), "--dataset.episode=0")
    refusal = "has other actions than this robot, they differ in right_gripper.pos; nothing was energised"
    check("radians", refusal, "lerobot-replay", *words, keys=KEYS["joint"][:-1])


def test_another_order_can_be_replayed_but_not_continued_or_rolled_out(check, tmp_path):
    words, other = words_of(dataset_of(tmp_path, "radians")), KEYS["joint"][7:] + KEYS["joint"][:7]
    check("radians", None, "lerobot-replay", *words, "--dataset.episode=0", keys=other)
    check("radians", "differ in their order", "lerobot-record", *words, "--resume=true", keys=other)
    path = save_scripted(tmp_path / "p", "nothing", arms=2, action_feature_names=KEYS["joint"])
    check("radians", "their order.*train a policy anew", "lerobot-rollout", f"--policy.path={path}", keys=other)


@pytest.mark.parametrize("recorded", ["radians", "poses"])
def test_the_training_data_of_a_policy_tell_where_they_are_at_hand(check, tmp_path, recorded):
    path = save_scripted(tmp_path / "p", "nothing", arms=2, stats=of_poses(2))
    (path / "train_config.json").write_text(json.dumps({"dataset": dataset_of(tmp_path, recorded)}))
    for robot in ("radians", "poses"):
        check(robot, says(robot, recorded), "lerobot-rollout", f"--policy.path={path}")


@pytest.mark.parametrize("degrees", [False, True], ids=["radians", "degrees"])
def test_what_no_tool_reaches_are_joints(check, tmp_path, degrees):
    path = save_scripted(tmp_path / "p", "nothing", arms=2, stats=statistics(2, degrees))
    check("poses", says("poses", "radians"), "lerobot-rollout", f"--policy.path={path}")


@pytest.mark.parametrize("space", NAMES)
@pytest.mark.parametrize("trained", [None, {}, {"repo_id": "local/elsewhere", "root": None}])
def test_a_checkpoint_that_does_not_tell_is_warned_of(tmp_path, monkeypatch, caplog, space, trained):
    path = save_scripted(tmp_path / "p", "nothing", arms=2, stats=of_poses(2))
    if trained is not None:
        (path / "train_config.json").write_text(json.dumps({"dataset": trained}))
    monkeypatch.setattr(sys, "argv", ["lerobot-rollout", f"--policy.path={path}"])
    check_cli("robot", KEYS[space], False)
    assert f"{path} does not tell joints from tool poses; this robot takes {NAMES[space]}" in caplog.text


def test_async_client_looks_at_the_checkpoint_that_it_names(monkeypatch, tmp_path):
    path = save_scripted(tmp_path / "p", "nothing", arms=2, stats=statistics(2, degrees=True))
    monkeypatch.setattr(sys, "argv", ["robot_client", f"--pretrained_name_or_path={path}"])
    with pytest.raises(ConfigError, match="is in degrees, this robot in radians"):
        check_cli("robot", KEYS["joint"], False)
    check_cli("robot", KEYS["joint"], True)


@pytest.mark.parametrize(
    "arguments, meaning, refusal",
    [
        ([], "radians", None),
        ([], "poses", "policy.action_space=joint_position is of joint positions, this robot takes tool poses"),
        (["--policy.action_space=cartesian_position"], "poses", None),
        (["--policy.action_space=cartesian_position"], "radians", "of tool poses, this robot takes joint positions"),
        (["--policy.action_space=cartesian_position", "--policy.angle_unit=deg"], "poses", "policy.angle_unit to rad"),
        (["--policy.angle_unit=deg"], "degrees", None),
        (["--policy.angle_unit=deg"], "radians", "policy.angle_unit is in degrees"),
        (["--policy.angle_unit=rad"], "degrees", "policy.angle_unit is in radians"),
    ],
)
def test_an_openpi_server_speaks_as_the_robot_does(check, arguments, meaning, refusal):
    check(meaning, refusal, "lerobot-rollout", "--policy.type=yam_openpi", *arguments)


def test_a_saved_openpi_policy_is_no_exception(monkeypatch, tmp_path):
    (tmp_path / "config.json").write_text('{"type": "yam_openpi", "action_space": "cartesian_position"}')
    monkeypatch.setattr(sys, "argv", ["lerobot-rollout", f"--policy.path={tmp_path}"])
    check_cli("robot", KEYS["ee"], False)
    with pytest.raises(ConfigError, match="of tool poses, this robot takes joint positions"):
        check_cli("robot", KEYS["joint"], False)


def test_what_no_arm_can_be_driven_by_cannot_be_asked_for(tmp_path, monkeypatch, capsys):
    words = "--policy.type=yam_openpi", "--policy.action_space=joint_velocity"
    error_of(tmp_path, monkeypatch, lerobot_rollout.main, {}, *words)
    assert "invalid choice: 'joint_velocity'" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [
        ["--dataset={{repo_id: local/data, root: {degrees}, episode: 0}}"],
        ["--dataset", "include {included}"],
        ["--dataset.episode=0", "--dataset.repo_id=local/data", "--dataset.root={radians}", "--dataset.root={degrees}"],
        ["--config_path={toml}"],
        ["--config_path={toml}", "--dataset.root", "{degrees}"],
        ["--dataset.root={radians}", "--dataset=include {included}"],
        ["--config_path={toml}", "--dataset={{episode: 0}}"],
        ["--dataset.root={radians}", "--dataset={{repo_id: local/data, root: {degrees}, episode: 0}}"],
    ],
)
def test_a_data_set_is_found_however_lerobot_takes_its_name(monkeypatch, tmp_path, arguments):
    places = {"degrees": write_dataset(tmp_path / "a", True), "radians": write_dataset(tmp_path / "b", False)}
    fields = {"repo_id": "local/data", "root": str(places["degrees"]), "episode": 0}
    (tmp_path / "data.yaml").write_text(json.dumps(fields))
    (tmp_path / "run.toml").write_text("[dataset]\n" + "".join(f"{k} = {json.dumps(v)}\n" for k, v in fields.items()))
    places |= {"included": tmp_path / "data.yaml", "toml": tmp_path / "run.toml"}
    monkeypatch.setattr(sys, "argv", ["lerobot-replay", *(text.format(**places) for text in arguments)])
    with pytest.raises(ConfigError, match="is in degrees, this robot in radians"):
        check_cli("robot", KEYS["joint"], False)
    check_cli("robot", KEYS["joint"], True)


@pytest.mark.parametrize("text", ["[", "include nowhere.yaml", "x", "null"])
def test_what_is_no_data_set_is_left_to_lerobot(monkeypatch, text):
    monkeypatch.setattr(sys, "argv", ["lerobot-replay", f"--dataset={text}", "--dataset.episode=0"])
    check_cli("robot", KEYS["joint"], False)


def test_an_episode_that_is_no_number_is_left_to_lerobot(monkeypatch, tmp_path):
    words = words_of(dataset_of(tmp_path, "radians"), "--dataset.episode=first")
    monkeypatch.setattr(sys, "argv", ["lerobot-replay", *words])
    check_cli("robot", KEYS["joint"], False)


@pytest.mark.parametrize(
    ("program", "refuses"), [("/bin/lerobot-train", False), ("x/lerobot_train.py", False), ("lerobot-eval", True)]
)
def test_the_checkpoint_from_which_a_training_begins_moves_nothing(monkeypatch, tmp_path, program, refuses):
    path = save_scripted(tmp_path / "p", "nothing", arms=2, stats=statistics(2, degrees=True))
    monkeypatch.setattr(sys, "argv", [program, f"--policy.path={path}"])
    with pytest.raises(ConfigError, match="is in degrees") if refuses else contextlib.nullcontext():
        check_cli("robot", KEYS["joint"], False)


def test_an_unknown_unit_is_said(monkeypatch, caplog):
    monkeypatch.setattr(sys, "argv", ["lerobot-rollout", "--policy.path=nobody/nothing"])
    check_cli("robot", KEYS["joint"], True)
    assert "nobody/nothing does not tell its unit; this robot is in degrees" in caplog.text


@pytest.mark.parametrize("words", [[], ["script.py"], ["script.py", "--flag"], [""]])
def test_a_script_of_ones_own_is_not_looked_at(monkeypatch, caplog, words):
    monkeypatch.setattr(sys, "argv", words)
    check_cli("robot", KEYS["joint"], False)
    assert not [record for record in caplog.records if record.name.startswith("lerobot_robot_yam")]


def test_commands_without_a_recording_are_not_looked_at(monkeypatch, caplog):
    monkeypatch.setattr(sys, "argv", ["lerobot-record", f"--config_path={ROOT / 'configs' / 'sim' / 'record.yaml'}"])
    check_cli("robot", KEYS["joint"], True)
    assert not [record for record in caplog.records if record.name.startswith("lerobot_robot_yam")]
