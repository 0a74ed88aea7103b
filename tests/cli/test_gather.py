"""`yam-gather`: demonstrations become a LeRobot data set, and a second run goes on where the first has ended."""

import importlib
import json
import shutil
import time

import numpy as np
import pytest
from lerobot.datasets import video_utils
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from lerobot_robot_yam.commands.configs import config_path
from lerobot_robot_yam.commands.data.gathering import _open, environment, gather
from lerobot_robot_yam.errors import ConfigError, RigError
from tests.cli.conftest import Commands
from tests.support.paths import ROOT


@pytest.mark.long
def test_demonstrations_are_gathered_and_more_of_them_later(tmp_path):
    commands, root = Commands(None, tmp_path), tmp_path / "data"
    for episodes in (1, 2):
        arguments = [str(config_path("train/lift_and_place_eval")), f"--root={root}", f"--episodes={episodes}"]
        assert commands.run("yam-gather", *arguments) == 0, commands.output()[-4000:]
    assert f"the data are in {root}" in commands.output()
    seeds = json.loads((root / "seeds.json").read_text())
    assert sum(seeds.values()) == 2
    data = LeRobotDataset("local/yam_gathered", root=root)
    assert data.num_episodes == 2 and data.fps == 30
    first, last = data[0], data[len(data) - 1]
    assert first["action"].shape == first["observation.state"].shape == (7,)
    for name, camera in environment(config_path("train/lift_and_place_eval")).robot.cameras.items():
        seen = [np.asarray(row[f"observation.images.{name}"]) for row in (first, last)]
        assert seen[0].shape == (3, camera.height, camera.width) and np.abs(seen[1] - seen[0]).mean() > 0.005


@pytest.mark.long
def test_attempts_that_fail_are_dropped_and_many_in_a_row_are_an_error(tmp_path):
    env, root = environment(config_path("train/lift_and_place_eval")), tmp_path / "data"
    env.robot.cameras, env.time_limit_s = {}, 0.2  # no operator is so fast
    with pytest.raises(RigError, match="failed 20 times in a row"):
        gather(env, root, "local/gathered", 1, 7)
    assert json.loads((root / "seeds.json").read_text()) == {str(seed): False for seed in range(7, 27)}
    assert json.loads((root / "meta" / "info.json").read_text())["total_frames"] == 0


@pytest.mark.long
def test_a_run_that_was_killed_while_it_saved_is_mended_before_it_goes_on(tmp_path, monkeypatch):
    """Rows that no metadata count: LeRobot would shift the actions of every episode that follows."""
    env, root = environment(config_path("train/lift_and_place_eval")), tmp_path / "data"
    env.robot.cameras = {}
    for _ in range(2):
        if root.exists():
            shutil.copytree(root / "meta", tmp_path / "meta")
        data = _open(env, root, "local/gathered", 3)
        for _ in range(3):
            data.add_frame({"action": np.zeros(7, "f4"), "observation.state": np.zeros(7, "f4"), "task": "none"})
        data.save_episode()
        data.finalize()
    (root / "tmpabcd").mkdir()  # of a run that was killed before it saved: nothing is wrong with the data
    _open(env, root, "local/gathered", 3).finalize()
    shutil.rmtree(root / "meta")
    shutil.copytree(tmp_path / "meta", root / "meta")
    with pytest.raises(ConfigError, match=f"yam-repair-dataset {root}"):
        _open(env, root, "local/gathered", 3)
    (root / "seeds.json").write_text('{"7": true}')
    monkeypatch.syspath_prepend(ROOT / "scripts")
    importlib.import_module("train_proof").mend(tmp_path)
    assert (root / "seeds.json").read_text() == '{"7": true}' and (tmp_path / "data_killed").is_dir()
    whole = _open(env, root, "local/gathered", 3)
    assert whole.num_episodes == 2
    whole.finalize()


def test_an_environment_that_cannot_be_leaves_no_data_behind(tmp_path):
    env = environment(config_path("train/lift_and_place_eval"))
    env.robot.channel = "nowhere"
    with pytest.raises(ConfigError, match="nowhere"):
        gather(env, tmp_path / "data", "local/gathered", 1, 7)
    assert not (tmp_path / "data").exists()


def test_data_of_other_cameras_are_not_gone_on_with(tmp_path):
    env, root = environment(config_path("train/lift_and_place_eval")), tmp_path / "data"
    _open(env, root, "local/gathered", 3).finalize()
    env.robot.cameras = {}
    with pytest.raises(ConfigError, match="features is .*images.wrist_left.* give another --root"):
        _open(env, root, "local/gathered", 3)


def test_no_picture_is_dropped_however_slow_the_encoder_is(tmp_path, monkeypatch, caplog):
    """In lock-step pictures come as fast as the machine makes them."""
    encode = video_utils._CameraEncoderThread.run
    monkeypatch.setattr(video_utils._CameraEncoderThread, "run", lambda self: (time.sleep(1.5), encode(self)))
    env, root = environment(config_path("train/lift_and_place_eval")), tmp_path / "data"
    data = _open(env, root, "local/gathered", 60)
    black, zeros = np.zeros((48, 64, 3), np.uint8), np.zeros(7, np.float32)
    for _ in range(60):
        row = {"action": zeros, "observation.state": zeros, "observation.images.wrist_left": black, "task": "none"}
        data.add_frame(row)
    data.save_episode()
    data.finalize()
    assert "queue full" not in caplog.text


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "No such file"),
        ("env: {type: yam, lokstep: true}", "`lokstep`"),
        ("robot: {type: yam_follower}", "robot"),
        ("env: [", "flow"),
        ("- 1", "list"),
    ],
)
def test_a_config_that_is_none_is_one_error(tmp_path, text, said):
    path = tmp_path / "env.yaml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(ConfigError, match=rf"env.yaml is no config of lerobot-eval: (?s:.*){said}"):
        environment(path)


def test_an_environment_in_real_time_is_refused(tmp_path):
    config = tmp_path / "live.yaml"
    config.write_text(config_path("train/lift_and_place_eval").read_text().replace("lockstep: true", "lockstep: false"))
    with pytest.raises(ConfigError, match="lockstep: true"):
        environment(config)


def test_another_environment_is_not_mixed_into_a_data_set(tmp_path):
    env, root = environment(config_path("train/lift_and_place_eval")), tmp_path / "data"
    _open(env, root, "local/gathered", 3).finalize()
    _open(env, root, "local/gathered", 3).finalize()
    env.fps = 15
    with pytest.raises(ConfigError, match="its fps is 30, that of the environment 15"):
        _open(env, root, "local/gathered", 3)
    env.fps, env.robot.use_degrees = 30, True
    with pytest.raises(ConfigError, match="its robot is yam_follower, that of the environment yam_follower_degrees"):
        _open(env, root, "local/gathered", 3)
    env.robot.use_degrees, env.robot.action_space = False, "ee"
    with pytest.raises(ConfigError, match="its robot is yam_follower, that of the environment yam_follower_ee"):
        _open(env, root, "local/gathered", 3)
