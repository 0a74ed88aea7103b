"""Check of a rig's file with yam-doctor's rules and LeRobot's parser. Does not access any arm."""

import difflib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lerobot.robots import make_robot_from_config
from lerobot.robots.config import RobotConfig
from lerobot.teleoperators import make_teleoperator_from_config
from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_robot_yam.arm.profile_files import load_arm, load_gripper
from lerobot_robot_yam.doctor.kit.targets import from_config
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.devices.pair_check import Spoken, check_pair
from lerobot_robot_yam.face.lerobot_command.config_refusal import check_options, rig_device
from lerobot_robot_yam.system.strict_yaml import read_yaml

_REGISTRIES: dict[str, Any] = {"robot": RobotConfig, "teleop": TeleoperatorConfig}


def check_rig(path: Path) -> list[str]:
    """Check the file; return a description of its rig, as lines of text.

    Raises:
        ConfigError: the file has a mistake; the message gives the place of the first mistake, and a similar valid word.
    """
    document = read_yaml(path)
    for section in document:
        _known(f"{path}: there is no part", str(section), _REGISTRIES)
    if "robot" not in document:
        raise ConfigError(f"{path} has no robot: the followers are missing")
    for section, device in document.items():
        if not isinstance(device, Mapping) or "type" not in device:
            raise ConfigError(f"{path}, {section}: it has no type, such as bi_yam_follower")
        ours = [name for name in _REGISTRIES[section].get_known_choices() if "yam" in name]
        _known(f"{path}, {section}: there is no type", str(device["type"]), ours)
    from_config(path, None, check_options)
    configs = {section: rig_device(_REGISTRIES[section], section, {"file": str(path)}) for section in document}
    _check_channels(path, configs)
    bare = rig_device(RobotConfig, "robot", {"file": str(path), "cameras": False})  # yam-doctor checks the cameras
    robot, teleop = make_robot_from_config(bare), configs.get("teleop")
    if hasattr(bare, "arms") and hasattr(teleop, "arms"):
        check_pair(_spoken(robot, bare), _spoken(make_teleoperator_from_config(teleop), teleop))
    lines = [f"{section}: {config.type}, {', '.join(_channels(config))}" for section, config in configs.items()]
    cameras: Any = getattr(configs["robot"], "all_cameras", dict)()
    return [*lines, f"cameras: {', '.join(cameras) or 'none'}", f"{path} has no mistakes; yam-doctor looks at the arms"]


def _known(what: str, name: str, known: Any) -> None:
    if name not in known:
        near = difflib.get_close_matches(name, known, 1)
        raise ConfigError(f"{what} {name!r}" + (f"; {near[0]!r}?" if near else f"; there are {', '.join(known)}"))


def _spoken(device: Any, config: Any) -> Spoken:
    """Return how a device interprets its actions, without connecting the device."""
    models = [
        (load_arm(getattr(arm, "follower_arm", None) or arm.arm), load_gripper(getattr(arm, "ee_gripper", arm.gripper)))
        for arm in config.arms().values()
    ]
    return Spoken(device.name, list(device.action_features), config.use_degrees, models)


def _channels(config: Any) -> list[str]:
    base = getattr(config, "base_config", config if config.type == "yam_base" else None)
    arms = [arm.channel for arm in config.arms().values()] if hasattr(config, "arms") else []
    return arms if base is None else [*arms, base.channel]


def _check_channels(path: Path, configs: Mapping[str, Any]) -> None:
    channels = [channel for config in configs.values() for channel in _channels(config)]
    twice = {channel for channel in channels if channels.count(channel) > 1}
    if twice:
        raise ConfigError(f"{path}: channel {', '.join(twice)} is named twice; each part has a channel of its own")
