"""The options of the LeRobot command that runs: the command line, and the file of `--config_path` below it."""

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import draccus
import yaml
from draccus.argparsing import ArgumentParser
from draccus.utils import DraccusException, flatten
from lerobot.configs import parser

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.rig_file import device_of

# All that draccus raises: some errors of YAML, of files and of values in wrong places come through as they are.
_NOT_PARSED = (argparse.ArgumentError, DraccusException, yaml.YAMLError, OSError, TypeError, ValueError)


@dataclass
class _DatasetOptions:
    repo_id: str | None = None
    root: str | None = None
    episode: int | None = None


@dataclass
class _PolicyOptions:
    type: str | None = None
    pretrained_revision: str | None = None
    action_space: str | None = None
    angle_unit: str | None = None


@dataclass
class _Options:
    """The options that are looked at, of whatever command: the parser passes over all others."""

    dataset: _DatasetOptions = field(default_factory=_DatasetOptions)
    policy: _PolicyOptions = field(default_factory=_PolicyOptions)
    resume: bool = False
    pretrained_name_or_path: str | None = None
    rename_map: dict[str, str] = field(default_factory=dict)


@draccus.decode.register(_Options)
def _as_text(given: Mapping[str, Any], _: Sequence[str]) -> dict[str, str]:
    """Values by full name, such as `dataset.root`. Decoding would refuse the other options of a config file."""
    known = {name: given[name] for name in _Options.__dataclass_fields__ if name in given}
    return {name: str(value) for name, value in flatten(known).items() if value is not None}


def given_options() -> dict[str, str]:
    """The command's options, as draccus puts command line and config file together; empty where it cannot."""
    path = parser.parse_arg("config_path")
    file = path if path is not None and Path(path).is_file() else None  # else a repository of the hub
    try:
        known = ArgumentParser(_Options, file, prog="", add_help=False, exit_on_error=False)
        return known.parse_known_args(parser.filter_arg("config_path", sys.argv[1:]))[0]
    except _NOT_PARSED:  # LeRobot, which parses them in the same way, says what is wrong
        return {}


def channels_of(device: str) -> dict[str, str]:
    """Channels of the arms of a device ("robot", "teleop"), by the option that gives them."""
    path = parser.parse_arg("config_path")
    try:
        file = yaml.safe_load(Path(path).read_text()) if path is not None and Path(path).is_file() else {}
        file = {**file, device: device_of(device, file.get(device) or {})}
    except (yaml.YAMLError, OSError, AttributeError, TypeError, ConfigError):  # LeRobot's parser says what is wrong
        file = {}
    found = {}
    for arm in ("", "left_arm_config.", "right_arm_config."):
        option = f"{device}.{arm}channel"
        value: Any = file
        for key in option.split("."):
            value = value.get(key) if isinstance(value, Mapping) else None
        given = parser.parse_arg(option) or value
        if given:
            found[option] = str(given)
    return found
