"""The options of the LeRobot command in this process: its command line, over the file of `--config_path`.

The configs of devices are checked while LeRobot still parses, so there is no parsed command yet. LeRobot's own parser
reads the same words again, and keeps only the options that are checked.
"""

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
from lerobot_robot_yam.system.rig_file import ARMS_OF_TWO, device_of

# All that draccus raises, which includes errors of YAML, of files and of misplaced values.
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
    """The options that are checked, of any command: the parser ignores all others."""

    dataset: _DatasetOptions = field(default_factory=_DatasetOptions)
    policy: _PolicyOptions = field(default_factory=_PolicyOptions)
    resume: bool = False
    pretrained_name_or_path: str | None = None
    rename_map: dict[str, str] = field(default_factory=dict)


@draccus.decode.register(_Options)
def _as_text(given: Mapping[str, Any], _: Sequence[str]) -> dict[str, str]:
    """Return values by full name, such as `dataset.root`, as decoding would refuse other options of a config file."""
    known = {name: given[name] for name in _Options.__dataclass_fields__ if name in given}
    return {name: str(value) for name, value in flatten(known).items() if value is not None}


def given_options() -> dict[str, str]:
    """Return the checked options, by full name such as `dataset.root`; empty if LeRobot will refuse the command."""
    try:
        known = ArgumentParser(_Options, _config_file(), prog="", add_help=False, exit_on_error=False)
        return known.parse_known_args(parser.filter_arg("config_path", sys.argv[1:]))[0]
    except _NOT_PARSED:
        return {}


def channels_of(device: str) -> dict[str, str]:
    """Return the channels of the arms of a device ("robot", "teleop"), by the option that gives them."""
    path = _config_file()
    try:
        file = yaml.safe_load(Path(path).read_text()) if path is not None else {}
        told = device_of(device, file.get(device) or {})
    except (yaml.YAMLError, OSError, AttributeError, TypeError, ConfigError):  # LeRobot's parser reports it
        told = {}
    found = {}
    for name in ("", *ARMS_OF_TWO):
        option = ".".join(filter(None, (device, name, "channel")))
        arm = told.get(name) if name else told
        channel = parser.parse_arg(option) or (arm.get("channel") if isinstance(arm, Mapping) else None)
        if channel:
            found[option] = str(channel)
    return found


def _config_file() -> str | None:
    """Return the command's config file; None without one, or for a repository of the hub."""
    path = parser.parse_arg("config_path")
    return path if path is not None and Path(path).is_file() else None
