"""The check of the recording or policy that the running LeRobot command will use, before anything is energised.

No stock loop tells the robot what it is about to replay, resume or roll out. So the robot reads the command's options
with LeRobot's own parser: the command line, and the file of `--config_path` below it.
"""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import draccus
import numpy as np
from draccus.argparsing import ArgumentParser
from draccus.utils import flatten
from lerobot.configs import parser

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.datasets.recorded_actions import (
    DEGREES,
    RADIANS,
    check_names,
    check_space,
    check_unit,
    refuse_other_space,
    unit_of,
)
from lerobot_robot_yam.face.datasets.recording import config_of, of_checkpoint, of_dataset
from lerobot_robot_yam.face.devices.feature_names import space_of

_TRAINING = ("lerobot-train", "lerobot_train")
_SERVER_SPACES = {"joint_position": "joint", "cartesian_position": "ee"}  # RoboArena's words


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


@draccus.decode.register(_Options)
def _as_text(given: Mapping[str, Any], _: Sequence[str]) -> dict[str, str]:
    """Values by full name, such as `dataset.root`. Decoding would refuse the other options of a config file."""
    known = {name: given[name] for name in _Options.__dataclass_fields__ if name in given}
    return {name: str(value) for name, value in flatten(known).items() if value is not None}


def _given_options() -> dict[str, str]:
    """The command's options, as draccus puts command line and config file together; empty where it cannot."""
    path = parser.parse_arg("config_path")
    file = path if path is not None and Path(path).is_file() else None  # else a repository of the hub
    try:
        known = ArgumentParser(_Options, file, prog="", add_help=False, exit_on_error=False)
        return known.parse_known_args(parser.filter_arg("config_path", sys.argv[1:]))[0]
    except Exception:  # LeRobot, which parses them in the same way, says what is wrong
        return {}


def check_command(device: str, keys: Sequence[str], use_degrees: bool) -> None:
    """Refuse what this LeRobot command is about to replay, resume or roll out if its numbers mean something else.

    Raises:
        ConfigError: it is of other values, of tool poses instead of joints (or the reverse), or in the other unit.
    """
    space, options = space_of(keys), _given_options()
    recordings = []
    replays, resumes = "dataset.episode" in options, options.get("resume") == "True"
    repo_id = options.get("dataset.repo_id")
    if repo_id and (replays or resumes):
        data = of_dataset(repo_id, options.get("dataset.root"))
        check_names(device, keys, data, in_order=resumes)
        recordings.append(data)
    path = parser.get_path_arg("policy") or options.get("pretrained_name_or_path")  # the latter: async inference
    if Path(*sys.argv[:1]).stem in _TRAINING:
        path = None  # from where the training begins; its evaluations roll out what has been learnt since
    revision = options.get("policy.pretrained_revision")
    if path:
        learnt = of_checkpoint(path, revision)
        if set(learnt.names) == set(keys):  # LeRobot goes by the order then, not by the names
            check_names(device, keys, learnt, in_order=True)
        recordings.append(learnt)
    if space is None:  # a gripper alone
        return
    is_joint = np.array([not key.endswith("gripper.pos") for key in keys])
    for recording in recordings:
        check_space(device, keys, recording)
        if space == "joint":  # poses of a tool have one unit
            check_unit(device, use_degrees, recording.what, unit_of(recording, is_joint))
    saved = config_of(path, revision) if path else {}
    if (options.get("policy.type", saved.get("type"))) == "yam_openpi":
        _check_server(device, keys, use_degrees, saved, options)


def _check_server(
    device: str, keys: Sequence[str], use_degrees: bool, saved: Mapping[str, Any], options: Mapping[str, str]
) -> None:
    """The same for what the options of a yam_openpi policy, or its saved config, say of its server."""
    from lerobot_robot_yam.face.openpi.configuration_openpi import YamOpenpiConfig

    space = options.get("policy.action_space") or saved.get("action_space") or YamOpenpiConfig.action_space
    refuse_other_space(device, keys, f"policy.action_space={space}", _SERVER_SPACES[space])
    degrees = (options.get("policy.angle_unit") or saved.get("angle_unit")) == "deg"
    if space_of(keys) == "joint":
        check_unit(device, use_degrees, "policy.angle_unit", DEGREES if degrees else RADIANS)
    elif degrees:
        raise ConfigError(f"{device}: tool poses are in m and rad; nothing was energised. Set policy.angle_unit to rad")
