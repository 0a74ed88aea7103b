"""The look at what the running LeRobot command is going to move the arms by, before anything is energised.

No stock loop tells the robot what it is about to replay, resume or roll out. So the robot looks it up where LeRobot
itself finds the checkpoint, among the options of the command (`lerobot.configs.parser`).
"""

import itertools
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from draccus import cfgparsing
from draccus.utils import ParsingError, deflatten
from lerobot.configs import parser

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.datasets.recorded_space import check_names, check_space, refuse_other_space
from lerobot_robot_yam.face.datasets.recorded_unit import DEGREES, RADIANS, check_unit, unit_of
from lerobot_robot_yam.face.datasets.recording import config_of, of_checkpoint, of_dataset
from lerobot_robot_yam.face.devices.feature_names import space_of

_ABSENT = object()
_TRAINING = ("lerobot-train", "lerobot_train")
_SERVER_SPACES = {"joint_position": "joint", "cartesian_position": "ee"}  # RoboArena's words


def check_command(device: str, keys: Sequence[str], use_degrees: bool) -> None:
    """Refuse what this LeRobot command is about to replay, resume or roll out if its numbers mean something else.

    Args:
        device: for messages.
        keys: of the robot's action, in canonical order.
        use_degrees: the robot's option.

    Raises:
        ConfigError: it is of other values, of tool poses instead of joints (or the reverse), or in the other unit.
    """
    space = space_of(keys)
    recordings = []
    replays, resumes = _option("dataset.episode") is not None, _flag("resume")
    repo_id = _option("dataset.repo_id")
    if repo_id and (replays or resumes):
        data = of_dataset(repo_id, _option("dataset.root"))
        check_names(device, keys, data, in_order=resumes)
        recordings.append(data)
    path = parser.get_path_arg("policy") or _option("pretrained_name_or_path")  # the latter: async inference
    if Path(*sys.argv[:1]).stem in _TRAINING:
        path = None  # from where the training begins; its evaluations roll out what has been learnt since
    if path:
        learnt = of_checkpoint(path, _option("policy.pretrained_revision"))
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
    saved = config_of(path, _option("policy.pretrained_revision")) if path else {}
    if (_option("policy.type") or saved.get("type")) == "yam_openpi":
        _check_server(device, keys, use_degrees, saved)


def _check_server(device: str, keys: Sequence[str], use_degrees: bool, saved: Mapping[str, Any]) -> None:
    """The same for what the options of a yam_openpi policy, or its saved config, say of its server."""
    from lerobot_robot_yam.face.openpi.configuration_openpi import YamOpenpiConfig

    space = _option("policy.action_space") or saved.get("action_space") or YamOpenpiConfig.action_space
    refuse_other_space(device, keys, f"policy.action_space={space}", _SERVER_SPACES[space])
    degrees = (_option("policy.angle_unit") or saved.get("angle_unit")) == "deg"
    if space_of(keys) == "joint":
        check_unit(device, use_degrees, "policy.angle_unit", DEGREES if degrees else RADIANS)
    elif degrees:
        raise ConfigError(f"{device}: tool poses are in m and rad; nothing was energised. Set policy.angle_unit to rad")


def _flag(name: str) -> bool:
    """A truth value, in any of YAML's words for it, as LeRobot's parser takes them."""
    return yaml.safe_load(_option(name) or "") is True


def _option(name: str) -> str | None:
    """A value from the command line, or from the file of `--config_path`, as text; as draccus puts them together.

    The last one counts, and `--dataset='{repo_id: me/x}'` or `--dataset="include file.yaml"` give some fields of it.
    """
    try:
        given = deflatten({option: _parsed(text) for option, text in _given()})
    except TypeError:  # a value, and fields of it: draccus takes that no more than we
        given = {}
    value = _field(given, name)
    if value is _ABSENT:
        value = _field(_config_file(), name)
    if isinstance(value, bool):
        return str(value).lower()
    return None if value is None or value is _ABSENT else str(value)


def _given() -> Iterator[tuple[str, str]]:
    """The options of the command line with their values, in order."""
    for word, following in itertools.pairwise([*sys.argv[1:], "--"]):
        option, is_there, value = word.removeprefix("--").partition("=")
        if word.startswith("--") and (is_there or not following.startswith("--")):
            yield option, value if is_there else following


def _config_file() -> Any:
    path = parser.parse_arg("config_path")
    if path is None or not Path(path).is_file():
        return None
    with open(path) as file:
        return cfgparsing.load_config(file, file=path)


def _parsed(text: str) -> Any:
    """What stands for several fields; None where it is nothing that draccus reads, which says so itself."""
    try:
        value = cfgparsing.parse_string(text)
        if isinstance(value, str) and value.startswith("include "):
            with open(value.removeprefix("include ")) as file:
                return cfgparsing.load_config(file, file=file.name)
    except (OSError, yaml.YAMLError, ParsingError):
        return None
    return value


def _field(value: Any, name: str) -> Any:
    """The field `a.b` of a mapping, `_ABSENT` where there is none."""
    for key in name.split("."):
        if not isinstance(value, Mapping) or key not in value:
            return _ABSENT
        value = value[key]
    return value
