"""Degrees or radians: data sets and checkpoints tell, and no stock command moves an arm by the wrong one.

Nothing here can move: there is no rig. `tests/cli/test_rollout.py` looks at one.
"""

import contextlib
import json
import sys
from functools import partial

import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset
from lerobot.scripts import lerobot_record, lerobot_replay, lerobot_rollout
from lerobot.utils.feature_utils import hw_to_dataset_features

from lerobot_robot_yam.errors import ActionError, ConfigError
from lerobot_robot_yam.face.datasets.recording import Recording, of_checkpoint, of_dataset
from lerobot_robot_yam.face.devices.cli_check import check_cli, unit_of
from lerobot_robot_yam.session.target_limits import refuse_degrees
from tests.cli.conftest import ROOT
from tests.policy_plugin.checkpoints import save_scripted, statistics
from tests.support.recordings import IS_JOINT, KEYS, NOWHERE, error_of, refused, robot, went_on, write_dataset
from tests.support.tiers import spread

UNITS = [False, True]
HALF = spread(UNITS, 0)
named = pytest.mark.parametrize("degrees", UNITS, ids=["radians", "degrees"])


# what tells


@named
def test_a_data_set_says_in_which_unit_it_is(tmp_path, degrees):
    root = write_dataset(tmp_path, degrees)
    info = json.loads((root / "meta" / "info.json").read_text())
    assert info["robot_type"] == ("bi_yam_follower_degrees" if degrees else "bi_yam_follower")
    assert unit_of(of_dataset("local/data", str(root)), IS_JOINT) == ("degrees" if degrees else "radians")


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


# stock commands


@pytest.fixture
def command(tmp_path, monkeypatch):
    return partial(error_of, tmp_path, monkeypatch)


@named
@pytest.mark.parametrize("recorded", UNITS, ids=["of radians", "of degrees"])
def test_replay(command, tmp_path, degrees, recorded):
    dataset = {"repo_id": "local/data", "root": str(write_dataset(tmp_path, recorded)), "episode": 0}
    error = command(lerobot_replay.main, {"robot": {"use_degrees": degrees}, "dataset": dataset})
    assert went_on(error) if degrees == recorded else refused(error, "is in degrees" if recorded else "is in radians")


def test_replay_of_what_the_command_line_says_over_the_file(command, tmp_path):
    data = {degrees: str(write_dataset(tmp_path, degrees)) for degrees in UNITS}
    document = {"robot": {"use_degrees": True}, "dataset": {"repo_id": "local/x", "root": data[True], "episode": 0}}
    assert refused(command(lerobot_replay.main, document, f"--dataset.root={data[False]}"), "is in radians")


@named
@pytest.mark.parametrize("recorded", HALF, ids=["of radians", "of degrees"])
def test_rollout(command, tmp_path, degrees, recorded):
    path = save_scripted(tmp_path / "p", "nothing", arms=2, stats=statistics(2, recorded))
    error = command(lerobot_rollout.main, {"robot": {"use_degrees": degrees}, "policy": {"path": str(path)}})
    assert went_on(error) if degrees == recorded else refused(error, "is in degrees" if recorded else "is in radians")


@named
@pytest.mark.parametrize("recorded", HALF, ids=["of radians", "of degrees"])
def test_resuming_a_rollout(command, tmp_path, degrees, recorded):
    path = save_scripted(tmp_path / "p", "nothing", arms=2, stats=statistics(2, degrees))
    dataset = {"repo_id": "local/rollout_data", "root": str(write_dataset(tmp_path, recorded)), "push_to_hub": False}
    document = {"robot": {"use_degrees": degrees}, "dataset": dataset, "strategy": {"type": "sentry"}, "resume": True}
    error = command(lerobot_rollout.main, document, f"--policy.path={path}")
    assert went_on(error) if degrees == recorded else refused(error, "is in degrees" if recorded else "is in radians")


@named
@pytest.mark.parametrize("recorded", HALF, ids=["of radians", "of degrees"])
def test_resuming_a_recording(command, tmp_path, degrees, recorded):
    dataset = {"repo_id": "local/data", "root": str(write_dataset(tmp_path, recorded)), "push_to_hub": False}
    document = {"robot": {"use_degrees": degrees}, "dataset": dataset | {"single_task": "none"}, "resume": True}
    document["teleop"] = {"type": "bi_yam_leader", "use_degrees": degrees}
    document["teleop"] |= {f"{side}_arm_config": {**NOWHERE, "channel": f"l_{side}"} for side in ("left", "right")}
    error = command(lerobot_record.main, document)
    assert went_on(error) if degrees == recorded else refused(error, "is in degrees" if recorded else "is in radians")


def test_async_client_looks_at_the_checkpoint_that_it_names(monkeypatch, tmp_path):
    path = save_scripted(tmp_path / "p", "nothing", arms=2, stats=statistics(2, degrees=True))
    monkeypatch.setattr(sys, "argv", ["robot_client", f"--pretrained_name_or_path={path}"])
    with pytest.raises(ConfigError, match="is in degrees, this robot in radians"):
        check_cli("robot", KEYS["joint"], False)
    check_cli("robot", KEYS["joint"], True)


@pytest.mark.parametrize("unit, degrees, fits", [("deg", True, True), ("deg", False, False), ("rad", True, False)])
def test_an_openpi_server_speaks_the_robots_unit(monkeypatch, unit, degrees, fits):
    arguments = ["lerobot-rollout", "--policy.type=yam_openpi", f"--policy.angle_unit={unit}"]
    monkeypatch.setattr(sys, "argv", arguments)
    with contextlib.nullcontext() if fits else pytest.raises(ConfigError, match="policy.angle_unit is in"):
        check_cli("robot", KEYS["joint"], degrees)


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


# in whatever program


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
