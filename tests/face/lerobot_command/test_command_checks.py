"""A LeRobot command that names what is not there is refused before anything is opened."""

import json
import sys

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.lerobot_command.command_checks import check_cli
from tests.support.lerobot_calls import while_parsing

KEYS = [*(f"joint_{n}.pos" for n in range(1, 7)), "gripper.pos"]


@pytest.fixture
def run(monkeypatch, tmp_path):
    """Checks a command as the robot does; the working directory is a new one."""
    monkeypatch.chdir(tmp_path)

    def check(name, cameras=(), path=None, **options):
        monkeypatch.setattr(sys, "argv", [name, *([f"--policy.path={path}"] if path else [])])
        while_parsing(lambda: check_cli("yam_follower", KEYS, False, cameras), **options)

    return check


CUBES = {"repo_id": "me/cubes", "root": "cubes"}


def data_set(root, episodes):
    (root / "meta" / "episodes" / "chunk-000").mkdir(parents=True)
    (root / "meta" / "info.json").write_text(json.dumps({"total_episodes": episodes}))
    if episodes:
        pq.write_table(pa.table({"episode_index": range(episodes)}), root / "meta/episodes/chunk-000/file-000.parquet")


def test_a_replay_of_nothing_says_what_is_there(run, tmp_path):
    data_set(tmp_path / "data" / "cubes", 3)
    data_set(tmp_path / "data" / "cups", 3)
    with pytest.raises(ConfigError, match="no data set in data/cube; data has cubes, cups"):
        run("lerobot-replay", dataset={"repo_id": "me/cube", "root": "data/cube", "episode": 0})


@pytest.mark.parametrize("episode", [3, "3"])
def test_a_replay_of_an_episode_that_is_not_there_says_which_are(run, tmp_path, episode):
    data_set(tmp_path / "cubes", 3)
    with pytest.raises(ConfigError, match="cubes has no episode 3, but 0 to 2"):
        run("lerobot-replay", dataset=CUBES | {"episode": episode})


def test_resuming_nothing_is_refused(run):
    with pytest.raises(ConfigError, match="no data set in cubes"):
        run("lerobot-record", dataset=CUBES, resume=True)


@pytest.mark.parametrize("torn", ["never written", "not closed"])
def test_a_data_set_that_was_not_closed_is_to_be_repaired(run, tmp_path, torn):
    data_set(tmp_path / "cubes", 3)
    (table,) = (tmp_path / "cubes").glob("meta/episodes/**/*.parquet")
    table.unlink() if torn == "never written" else table.write_bytes(table.read_bytes()[:-9])
    for options in ({"dataset": CUBES, "resume": True}, {"dataset": CUBES | {"episode": 1}}):
        with pytest.raises(ConfigError, match="was not closed, and does not load; `yam-repair-dataset cubes`"):
            run("lerobot-record", **options)


@pytest.mark.parametrize(
    ("episodes", "file", "says"),
    [
        (12, None, "holds 12 episodes; add --resume=true"),
        (0, None, "holds no episode; remove it .rm -r cubes."),
        (0, "cubes/file-000.parquet", "there are rows or images of one all the same: `yam-repair-dataset cubes`"),
        (None, "cubes/data.txt", "is no data set; choose another dataset.root"),
    ],
)
def test_recording_over_a_data_set_says_how_to_go_on(run, tmp_path, episodes, file, says):
    run("lerobot-record", dataset=CUBES)  # a new one is taken
    (tmp_path / "cubes").mkdir() if episodes is None else data_set(tmp_path / "cubes", episodes)
    if file is not None:
        (tmp_path / file).touch()
    with pytest.raises(ConfigError, match=f"cubes is there already and .*{says}"):
        run("lerobot-record", dataset=CUBES)


def test_a_channel_that_two_arms_have_is_told_with_both_options(run):
    with pytest.raises(ConfigError, match="channel can0 is given twice, by robot.channel and teleop.channel"):
        run("lerobot-teleoperate", robot={"channel": "can0"}, teleop={"channel": "can0"})
    arms = {side: {f"{hand}_arm_config": {"channel": f"{side}_{hand}"} for hand in ("left", "right")} for side in "rt"}
    run("lerobot-teleoperate", robot=arms["r"], teleop=arms["t"])
    arms["t"]["right_arm_config"]["channel"] = "r_left"
    with pytest.raises(ConfigError, match="r_left is given twice, by robot.left_arm_config.channel and teleop.right"):
        run("lerobot-teleoperate", robot=arms["r"], teleop=arms["t"])


def policy(root, *cameras, kind="act"):
    root.mkdir()
    features = {f"observation.images.{name}": {"type": "VISUAL", "shape": [3, 240, 320]} for name in cameras}
    features["observation.state"] = {"type": "STATE", "shape": [7]}
    (root / "config.json").write_text(json.dumps({"type": kind, "input_features": features}))


def test_a_policy_that_sees_other_cameras_is_refused(run, tmp_path):
    policy(tmp_path / "act", "top", "wrist")
    with pytest.raises(ConfigError, match="sees the cameras top, wrist, this robot has top, wrist_left; is 'wrist_l"):
        run("lerobot-rollout", ["top", "wrist_left"], "act")
    with pytest.raises(ConfigError, match="this robot has none; configure 'top' under robot.cameras"):
        run("lerobot-rollout", path="act")
    run("lerobot-rollout", ["top", "wrist", "side"], "act")
    run("lerobot-rollout", path="act", rename_map={"observation.images.top": "observation.images.wrist"})


def test_a_policy_that_fills_in_missing_cameras_is_taken(run, tmp_path):
    policy(tmp_path / "pi", "top", "wrist", "empty_camera_0", kind="pi05")
    run("lerobot-rollout", ["top"], "pi")
    with pytest.raises(ConfigError, match="sees the cameras top, wrist, this robot has side"):
        run("lerobot-rollout", ["side"], "pi")
