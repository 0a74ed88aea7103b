"""A LeRobot command that names what is not there is refused before anything is opened."""

import json
import sys

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.lerobot_command.command_checks import check_cli

KEYS = [*(f"joint_{n}.pos" for n in range(1, 7)), "gripper.pos"]


@pytest.fixture
def run(monkeypatch, tmp_path):
    """Checks a command as the robot does; the working directory is a new one."""
    monkeypatch.chdir(tmp_path)

    def check(name, *arguments, cameras=()):
        monkeypatch.setattr(sys, "argv", [name, *arguments])
        check_cli("yam_follower", KEYS, False, cameras)

    return check


def data_set(root, episodes):
    (root / "meta" / "episodes" / "chunk-000").mkdir(parents=True)
    (root / "meta" / "info.json").write_text(json.dumps({"total_episodes": episodes}))
    if episodes:
        pq.write_table(pa.table({"episode_index": range(episodes)}), root / "meta/episodes/chunk-000/file-000.parquet")


def test_a_replay_of_nothing_says_what_is_there(run, tmp_path):
    data_set(tmp_path / "data" / "cubes", 3)
    data_set(tmp_path / "data" / "cups", 3)
    with pytest.raises(ConfigError, match="no data set in data/cube; data has cubes, cups"):
        run("lerobot-replay", "--dataset.repo_id=me/cube", "--dataset.root=data/cube", "--dataset.episode=0")


def test_a_replay_of_an_episode_that_is_not_there_says_which_are(run, tmp_path):
    data_set(tmp_path / "cubes", 3)
    with pytest.raises(ConfigError, match="cubes has no episode 3, but 0 to 2"):
        run("lerobot-replay", "--dataset.repo_id=me/cubes", "--dataset.root=cubes", "--dataset.episode=3")


def test_resuming_nothing_is_refused(run):
    with pytest.raises(ConfigError, match="no data set in cubes"):
        run("lerobot-record", "--dataset.repo_id=me/cubes", "--dataset.root=cubes", "--resume=true")


@pytest.mark.parametrize("torn", ["never written", "not closed"])
def test_a_data_set_that_was_not_closed_is_to_be_repaired(run, tmp_path, torn):
    data_set(tmp_path / "cubes", 3)
    (table,) = (tmp_path / "cubes").glob("meta/episodes/**/*.parquet")
    table.unlink() if torn == "never written" else table.write_bytes(table.read_bytes()[:-9])
    for option in ("--resume=true", "--dataset.episode=1"):
        with pytest.raises(ConfigError, match="was not closed, and does not load; `yam-repair-dataset cubes`"):
            run("lerobot-record", "--dataset.repo_id=me/cubes", "--dataset.root=cubes", option)


@pytest.mark.parametrize(
    ("episodes", "says"),
    [(12, "holds 12 episodes; add --resume=true"), (0, "holds no episode; remove it .rm -r cubes.")],
)
def test_recording_over_a_data_set_says_how_to_go_on(run, tmp_path, episodes, says):
    data_set(tmp_path / "cubes", episodes)
    with pytest.raises(ConfigError, match=f"cubes is there already and {says}"):
        run("lerobot-record", "--dataset.repo_id=me/cubes", "--dataset.root=cubes")


def test_a_new_data_set_is_taken(run):
    run("lerobot-record", "--dataset.repo_id=me/cubes", "--dataset.root=cubes")


def test_a_channel_that_two_arms_have_is_told_with_both_options(run):
    both = "channel can0 is given twice, by robot.channel and teleop.channel"
    with pytest.raises(ConfigError, match=both):
        run("lerobot-teleoperate", "--robot.channel=can0", "--teleop.channel=can0")


def test_a_channel_given_twice_in_a_file_is_told_too(run, tmp_path):
    arms = {side: {f"{hand}_arm_config": {"channel": f"{side}_{hand}"} for hand in ("left", "right")} for side in "rt"}
    (tmp_path / "run.yaml").write_text(yaml.safe_dump({"robot": arms["r"], "teleop": arms["t"]}))
    run("lerobot-teleoperate", "--config_path=run.yaml")
    with pytest.raises(ConfigError, match="r_left is given twice, by robot.left_arm_config.channel and teleop.right"):
        run("lerobot-teleoperate", "--config_path=run.yaml", "--teleop.right_arm_config.channel=r_left")


def policy(root, *cameras, kind="act"):
    root.mkdir()
    features = {f"observation.images.{name}": {"type": "VISUAL", "shape": [3, 240, 320]} for name in cameras}
    features["observation.state"] = {"type": "STATE", "shape": [7]}
    (root / "config.json").write_text(json.dumps({"type": kind, "input_features": features}))


def test_a_policy_that_sees_other_cameras_is_refused(run, tmp_path):
    policy(tmp_path / "act", "top", "wrist")
    with pytest.raises(ConfigError, match="sees the cameras top, wrist, this robot has top, wrist_left; is 'wrist_l"):
        run("lerobot-rollout", "--policy.path=act", cameras=["top", "wrist_left"])
    with pytest.raises(ConfigError, match="this robot has none; configure 'top' under robot.cameras"):
        run("lerobot-rollout", "--policy.path=act")
    run("lerobot-rollout", "--policy.path=act", cameras=["top", "wrist", "side"])
    run("lerobot-rollout", "--policy.path=act", "--rename_map={observation.images.top: observation.images.wrist}")


def test_a_policy_that_fills_in_missing_cameras_is_taken(run, tmp_path):
    policy(tmp_path / "pi", "top", "wrist", "empty_camera_0", kind="pi05")
    run("lerobot-rollout", "--policy.path=pi", cameras=["top"])
    with pytest.raises(ConfigError, match="sees the cameras top, wrist, this robot has side"):
        run("lerobot-rollout", "--policy.path=pi", cameras=["side"])


def test_a_folder_of_data_sets_is_no_data_set(run, tmp_path):
    data_set(tmp_path / "data" / "cubes", 3)
    with pytest.raises(ConfigError, match="data is there already and is no data set; choose another dataset.root"):
        run("lerobot-record", "--dataset.repo_id=me/cubes", "--dataset.root=data")


def test_nobody_is_told_to_remove_what_can_be_rescued(run, tmp_path):
    data_set(tmp_path / "cubes", 0)
    (tmp_path / "cubes" / "file-000.parquet").touch()
    with pytest.raises(ConfigError, match="`yam-repair-dataset cubes`"):
        run("lerobot-record", "--dataset.repo_id=me/cubes", "--dataset.root=cubes")
