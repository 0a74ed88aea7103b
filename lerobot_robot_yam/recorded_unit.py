"""Degrees or radians: in which of them a data set or checkpoint is, and the refusal to move by the wrong one.

LeRobot records no units, but what it does record tells them:

- A data set names its robot: ours is called `bi_yam_follower_degrees` there while it gives degrees. lerobot-record
  compares that name itself when it resumes.
- A data set and a checkpoint hold statistics of the joints. No joint of these arms gets a whole turn away from zero:
  larger numbers are degrees, and a data set that has none is in radians (or of an arm that never left zero by 7°).

No stock loop tells the robot what it is about to replay, resume or roll out. So the robot looks it up where LeRobot
itself finds the checkpoint, among the options of the command (`lerobot.configs.parser`).
"""

import json
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from lerobot.configs import parser

from lerobot_robot_yam.arm.joints import TURN
from lerobot_robot_yam.errors import ConfigError

logger = logging.getLogger(__name__)

RADIANS, DEGREES = "radians", "degrees"
_SUFFIX = f"_{DEGREES}"
_OURS = ("yam_follower", "bi_yam_follower")
_STATISTICS = ("min", "max", "mean", "q01", "q99")  # any of them will do
_PIPELINES = ("policy_preprocessor.json", "policy_postprocessor.json")
_NORMALISERS = ("normalizer_processor", "unnormalizer_processor")


def recorded_name(device: str, use_degrees: bool) -> str:
    """What a robot is called in data sets, so that they tell their unit."""
    return f"{device}{_SUFFIX}" if use_degrees else device


def check_command(device: str, use_degrees: bool, is_joint: np.ndarray) -> None:
    """Refuse what this LeRobot command is about to replay, resume or roll out if it is in the other unit.

    Args:
        device: for messages.
        use_degrees: the robot's option.
        is_joint: (n,) which values of the robot's action are angles; the others are grippers.

    Raises:
        ConfigError: it is in the other unit.
    """
    if not is_joint.any():  # a gripper alone
        return
    unit = DEGREES if use_degrees else RADIANS
    for what, found in _sources(is_joint).items():
        if found is None:
            logger.warning("%s: %s does not tell its unit; this robot is in %s", device, what, unit)
        elif found != unit:
            raise ConfigError(
                f"{device}: {what} is in {found}, this robot in {unit}; nothing was energised. "
                f"Set the robot's use_degrees to {str(found == DEGREES).lower()}"
            )


def unit_of_dataset(repo_id: str, root: str | None, is_joint: np.ndarray) -> str | None:
    """Unit of a data set's joints, None if it does not tell.

    Args:
        repo_id, root: as LeRobot's options `dataset.repo_id` and `dataset.root`.
        is_joint: (n,) which values of an action are angles.
    """
    from lerobot.datasets import LeRobotDatasetMetadata

    try:
        meta = LeRobotDatasetMetadata(repo_id, root=root)
    except Exception as error:  # whatever is wrong with it: LeRobot, which is about to open it, says what
        logger.debug("data set %s: %s", repo_id, error)
        return None
    name = meta.robot_type or ""
    if name.endswith(_SUFFIX):
        return DEGREES
    found = unit_of_statistics(meta.stats or {}, is_joint)
    return RADIANS if found is None and name in _OURS else found


def unit_of_checkpoint(path: str, revision: str | None, is_joint: np.ndarray) -> str | None:
    """Unit of the joints that a policy was trained on, None if its checkpoint does not tell.

    Args:
        path, revision: a directory, or a repository of the hub, as LeRobot's `policy.path`.
        is_joint: (n,) which values of an action are angles.
    """
    from safetensors.numpy import load_file

    statistics: dict[str, dict[str, np.ndarray]] = {}
    for pipeline in _PIPELINES:
        file = _file(path, pipeline, revision)
        for step in json.loads(file.read_text()).get("steps", []) if file else []:
            state = step.get("state_file") if step.get("registry_name") in _NORMALISERS else None
            tensors = _file(path, state, revision) if state else None
            for key, value in load_file(tensors).items() if tensors else []:
                feature, _, statistic = key.rpartition(".")
                statistics.setdefault(feature, {})[statistic] = value
    return unit_of_statistics(statistics, is_joint)


def unit_of_statistics(statistics: Mapping[str, Mapping[str, Any]], is_joint: np.ndarray) -> str | None:
    """Unit that the statistics of a data set show, None if they are not of these joints.

    Args:
        statistics: LeRobot's, by feature and kind: {"action": {"max": (n,), …}, "observation.state": …}.
        is_joint: (n,) which values of an action are angles; in a state they come first.
    """
    n = len(is_joint)
    largest = []
    for feature in ("action", "observation.state"):
        for kind in _STATISTICS:
            values = np.ravel(statistics.get(feature, {}).get(kind, ()))
            if len(values) == n or (len(values) > n and feature != "action"):
                largest.append(float(np.abs(values[:n][is_joint]).max(initial=0.0)))
    if not largest:
        return None
    return DEGREES if max(largest) > TURN else RADIANS


def _sources(is_joint: np.ndarray) -> dict[str, str | None]:
    """Units of what the command is going to use, by what messages call it."""
    found: dict[str, str | None] = {}
    path = parser.get_path_arg("policy") or _option("pretrained_name_or_path")  # the latter: async inference
    if path:
        found[f"checkpoint {path}"] = unit_of_checkpoint(path, _option("policy.pretrained_revision"), is_joint)
    if _option("policy.type") == "yam_openpi":
        found["policy.angle_unit"] = DEGREES if _option("policy.angle_unit") == "deg" else RADIANS
    replays = _option("dataset.episode") is not None
    repo_id = _option("dataset.repo_id")
    if repo_id and (replays or _option("resume") == "true"):
        root = _option("dataset.root")
        found[f"data set {root or repo_id}"] = unit_of_dataset(repo_id, root, is_joint)
    return found


def _option(name: str) -> str | None:
    """A value from the command line, or from the file of `--config_path`, as text."""
    given = parser.parse_arg(name)
    path = parser.parse_arg("config_path")
    if given is not None or path is None or not Path(path).is_file():
        return given
    value = yaml.safe_load(Path(path).read_text())  # JSON is YAML too
    for key in name.split("."):
        value = value.get(key) if isinstance(value, Mapping) else None
    if isinstance(value, bool):
        return str(value).lower()
    return None if value is None else str(value)


def _file(path: str, name: str, revision: str | None) -> Path | None:
    """A file of a checkpoint; None where there is none, or no way to the hub."""
    if Path(path).is_dir():
        file = Path(path) / name
        return file if file.is_file() else None
    from huggingface_hub import hf_hub_download

    try:
        return Path(hf_hub_download(repo_id=path, filename=name, revision=revision))
    except Exception as error:  # no such file, no network, no name of a repository: it does not tell its unit
        logger.debug("checkpoint %s: %s", path, error)
        return None
