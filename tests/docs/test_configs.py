"""The shipped run configs are what LeRobot's own commands accept, and mean the same everywhere."""

import copy
import functools
import os
import subprocess
import sys
from pathlib import Path

import draccus
import pytest
import yaml
from lerobot.async_inference.configs import RobotClientConfig
from lerobot.configs.eval import EvalPipelineConfig
from lerobot.configs.train import TrainPipelineConfig
from lerobot.envs.utils import env_to_policy_features
from lerobot.robots import make_robot_from_config
from lerobot.rollout import RolloutConfig
from lerobot.scripts.lerobot_calibrate import CalibrateConfig
from lerobot.scripts.lerobot_record import RecordConfig
from lerobot.scripts.lerobot_replay import ReplayConfig
from lerobot.scripts.lerobot_teleoperate import TeleoperateConfig
from lerobot.teleoperators import make_teleoperator_from_config

from lerobot_robot_yam.commands.configs import config_names, config_path, configs_dir, copy_configs, main
from lerobot_robot_yam.commands.data.gathering import features_of
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.scene.scene import load_scene


class PolicylessRolloutConfig(RolloutConfig):
    """These configs leave the policy to the command line, where LeRobot's own class looks for it while it is made."""

    def __post_init__(self):
        pass


COMMANDS = {
    "record": RecordConfig,
    "teleoperate": TeleoperateConfig,
    "replay": ReplayConfig,
    "calibrate": CalibrateConfig,
    "rollout": PolicylessRolloutConfig,
    "dagger": PolicylessRolloutConfig,
    "async": RobotClientConfig,
}
RL = "sim/hil_serl"  # of LeRobot's RL stack: tests/cli/test_hil_serl.py
OF_DEVICES = [name for name in config_names() if not name.startswith("train/") and name != RL]
TRAINING = {"eval": EvalPipelineConfig, "train": TrainPipelineConfig}  # of one task each, under train/


RIG_FILE = "rig.yaml"  # that the configs below rig/ name


@pytest.fixture(autouse=True)
def a_rig(tmp_path, monkeypatch):
    """A rig's file where commands are run: the arms of the virtual rig."""
    document = yaml.safe_load(config_path("sim/record").read_text())
    (tmp_path / RIG_FILE).write_text(yaml.safe_dump({part: document[part] for part in ("robot", "teleop")}))
    monkeypatch.chdir(tmp_path)


@functools.cache
def parsed(name):
    return draccus.parse((COMMANDS | TRAINING)[name.rpartition("/")[2].rpartition("_")[2]], config_path(name), [])


def parse(name):
    """What LeRobot makes of a config: parsed once, a copy for each test."""
    return copy.deepcopy(parsed(name))


@pytest.mark.parametrize("place", ["sim", "real", "rig"])
@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_a_config(place, command):
    assert f"{place}/{command}" in config_names()


@pytest.mark.parametrize("name", OF_DEVICES)
def test_configs_parse_and_fit_together(name, tmp_path):
    config = parse(name)
    device = config.env.robot if name.endswith("/eval") else config.robot
    device.calibration_dir = tmp_path
    robot = make_robot_from_config(device)
    assert len(robot.action_features) == {"yam_follower": 7, "yam_mobile": 17}.get(robot.name, 14)
    teleop = getattr(config, "teleop", None)
    if teleop is not None:
        teleop.calibration_dir = tmp_path
        assert list(make_teleoperator_from_config(teleop).action_features) == list(robot.action_features)


def test_what_is_trained_fits_what_is_evaluated():
    """The policy's inputs are what the environment shows, in a data set that `yam-gather` makes of it."""
    for task in ("lift_and_place", "mobile_tables"):
        env = parse(f"train/{task}_eval").env
        assert env.lockstep and env.task == task and task in {row.name for row in load_scene(task).tasks}
        assert set(features_of(env)) == set(env_to_policy_features(env))
        train = parse(f"train/{task}_train")
        assert train.dataset.repo_id == f"local/{task}" and not train.policy.push_to_hub
        assert train.policy.n_action_steps <= train.policy.chunk_size


@pytest.mark.parametrize("name", [name for name in OF_DEVICES if name.startswith("sim/")])
def test_sim_configs_name_what_the_scene_has(name):
    config = parse(name)
    devices = [config.robot, *([config.teleop] if getattr(config, "teleop", None) else [])]
    arms = [arm for device in devices if hasattr(device, "arms") for arm in device.arms().values()]  # a hand has none
    (world,) = {arm.can_options["scene"] for arm in arms if "scene" in arm.can_options} or {None}
    scene = load_scene(world)
    for device in devices:
        for arm in device.arms().values() if hasattr(device, "arms") else ():
            placed = next(a for a in scene.arms if a.channel == arm.channel)
            assert (arm.interface, arm.arm, arm.gripper) == ("yam_sim", placed.arm, placed.gripper)
            assert getattr(arm, "gravity_factor", [1.0] * 6) == [1.0] * 6  # a leader without motors weighs nothing
            load_scene(world, {k: v for k, v in arm.can_options.items() if k not in ("rig", "scene")})
    for camera in config.robot.cameras.values():
        assert camera.camera in [c.name for c in scene.cameras]


def test_real_configs_use_four_named_channels():
    config = parse("real/record")
    channels = [arm.channel for device in (config.robot, config.teleop) for arm in device.arms().values()]
    assert channels == ["can_follower_l", "can_follower_r", "can_leader_l", "can_leader_r"]
    assert {camera.type for camera in config.robot.cameras.values()} == {"yam_realsense", "opencv"}


@pytest.mark.parametrize("name", [name for name in config_names() if name.endswith("record")])
def test_recording_needs_no_account_and_speaks_to_people_at_real_arms(name):
    config = parse(name)
    assert not config.dataset.push_to_hub and config.dataset.streaming_encoding
    assert config.play_sounds is name.startswith(("real", "rig"))


@pytest.mark.parametrize(
    "name", [name for name in config_names() if "streaming_encoding" in config_path(name).read_text()]
)
def test_ten_seconds_of_pictures_may_wait_for_the_encoder(name):
    dataset = parse(name).dataset
    assert dataset.encoder_queue_maxsize >= 10 * dataset.fps


@pytest.mark.parametrize("name", config_names())
def test_configs_are_commented(name):
    text = config_path(name).read_text()
    assert text.startswith("# ") and f"configs/{name}.yaml" in text.split("\n\n")[0]
    if name.startswith(("real/", "rig/")):
        assert "HAZARD" in text or "Nothing may be between them" in text


@pytest.mark.parametrize(
    "change, named",
    [
        ({"robot": {"left_arm_config": {"chanel": "x"}}}, "chanel"),
        ({"robot": {"left_arm_config": {"kp": [1, 2]}}}, "kp"),
        ({"robot": {"type": "yam_folower"}}, "yam_folower"),
    ],
)
def test_typing_errors_are_named(change, named, tmp_path):
    document = yaml.safe_load(config_path("sim/calibrate").read_text())
    for device, fields in change.items():
        for key, value in fields.items():
            document[device][key] = {**document[device][key], **value} if isinstance(value, dict) else value
    path = tmp_path / "wrong.yaml"
    path.write_text(yaml.safe_dump(document))
    with pytest.raises((ValueError, draccus.ParsingError), match=named):
        make_robot_from_config(draccus.parse(CalibrateConfig, path, [f"--robot.calibration_dir={tmp_path}"]).robot)


def test_copying_never_overwrites(tmp_path):
    copies = copy_configs(tmp_path)
    assert sorted(str(p.relative_to(tmp_path).with_suffix("")) for p in copies) == config_names()
    (tmp_path / "sim" / "record.yaml").write_text("mine")
    with pytest.raises(ConfigError, match="record.yaml"):
        copy_configs(tmp_path)
    assert (tmp_path / "sim" / "record.yaml").read_text() == "mine"


def test_command_lists_and_prints_paths(capsys):
    assert main([]) == 0
    assert str(configs_dir() / "sim" / "record.yaml") in capsys.readouterr().out
    assert main(["path", "sim/record"]) == 0
    assert Path(capsys.readouterr().out.strip()).is_file()
    assert main(["path", "sim/nothing"]) == 2
    assert "sim/record" in capsys.readouterr().err


def test_console_command_is_installed():
    command = Path(sys.executable).parent / "yam-configs"
    done = subprocess.run([command, "--help"], capture_output=True, text=True, env=dict(os.environ))
    assert done.returncode == 0 and "copy" in done.stdout
