"""Small data sets, and stock commands that are given them on a robot whose bus does not exist: nothing can move."""

import signal
import sys

import numpy as np
import pytest
import yaml
from draccus.utils import DecodingError
from lerobot.configs import parser
from lerobot.datasets import LeRobotDataset
from lerobot.robots import make_robot_from_config
from lerobot.utils.feature_utils import hw_to_dataset_features

from lerobot_robot_yam.config_yam_follower import BiYamFollowerConfig, FollowerArmConfig
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.devices.feature_names import action_keys

IS_JOINT = np.array(([True] * 6 + [False]) * 2)
NOWHERE = {"interface": "carrier_pigeon", "channel": "none"}  # whoever opens it fails otherwise than these tests expect
POSE_RAD = np.array([0.3, 1.2, 1.1, -0.5, 0.2, 0.3, 0.5] * 2)
POSE_TOOL = np.array([0.35, 0.1, 0.12, 0.0, 0.0, 0.3, 0.5] * 2)
ARMS = {f"{side}_": FollowerArmConfig(channel=side) for side in ("left", "right")}
KEYS = {space: action_keys(ARMS, space) for space in ("joint", "ee")}
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)


def robot(tmp_path, degrees=False, space="joint"):
    arms = {f"{prefix}arm_config": arm for prefix, arm in ARMS.items()}
    options = {"use_degrees": degrees, "action_space": space}
    return make_robot_from_config(BiYamFollowerConfig(calibration_dir=tmp_path, **options, **arms))


def write_dataset(tmp_path, degrees=False, robot_type=None, space="joint"):
    """A data set of two frames, as lerobot-record makes it; returns its directory."""
    device = robot(tmp_path, degrees, space)
    features = hw_to_dataset_features(device.action_features, "action")
    features |= hw_to_dataset_features(device.observation_features, "observation")
    root = tmp_path / f"data_{degrees}_{robot_type}_{space}"
    data = LeRobotDataset.create("local/data", 30, root=root, robot_type=robot_type or device.name, features=features)
    pose = POSE_TOOL if space == "ee" else np.where(IS_JOINT & degrees, np.degrees(POSE_RAD), POSE_RAD)
    for _ in range(2):
        row = pose.astype(np.float32)
        data.add_frame({"action": row, "observation.state": row, "task": "none"})
    data.save_episode()
    data.finalize()
    return root


def error_of(tmp_path, monkeypatch, main, document, *arguments):
    """What a stock command raises that runs in this process with that config and these arguments."""
    monkeypatch.setenv("HF_LEROBOT_CALIBRATION", str(tmp_path / "cal"))
    monkeypatch.setattr(parser, "_config_path_args", {})  # a process is one command, except here
    arms = {f"{side}_arm_config": {**NOWHERE, "channel": side} for side in ("left", "right")}
    document["robot"] = {"type": "bi_yam_follower", **arms, **document.get("robot", {})}
    path = tmp_path / "command.yaml"
    path.write_text(yaml.safe_dump(document | {"play_sounds": False}))
    monkeypatch.setattr(sys, "argv", ["command", f"--config_path={path}", *arguments])
    handlers = {number: signal.getsignal(number) for number in SIGNALS}
    try:
        with pytest.raises((ConfigError, ValueError, OSError, SystemExit)) as raised:
            main()
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    value = raised.value
    return value.__context__ if isinstance(value, SystemExit) else value  # what LeRobot's parser made a line of


def refused(error, because):
    """The command went no further than our look at what it was given."""
    return (
        isinstance(error, (ConfigError, DecodingError))
        and because in str(error)
        and "nothing was energised" in str(error)
    )


def went_on(error):
    """To a bus that does not exist."""
    return "carrier_pigeon" in str(error)
