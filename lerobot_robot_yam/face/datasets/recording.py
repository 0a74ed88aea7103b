"""Facts about the robot of a data set or checkpoint.

LeRobot records neither units nor the meaning of an action's values, but

- a data set names its robot (`recorded_name` gives this package's names) and the values of its actions;
- some checkpoints name these values, too, and all checkpoints name the data set of their training, which may be on this
  computer;
- both contain statistics of the values.
"""

import json
import logging
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.utils.constants import ACTION, HF_LEROBOT_HOME, OBS_STATE

from lerobot_robot_yam.arm.joint_map import TURN
from lerobot_robot_yam.face.datasets.layout import DEGREES_SUFFIX, value_names

logger = logging.getLogger(__name__)

RADIANS, DEGREES = "radians", "degrees"
_OURS = ("yam_follower", "bi_yam_follower", "yam_mobile")
_TOOL_SUFFIX = "_ee"
_STATISTICS = ("min", "max", "mean", "q01", "q99")  # LeRobot's statistics that are read; any one of these suffices
_PIPELINES = ("policy_preprocessor.json", "policy_postprocessor.json")
_NORMALISERS = ("normalizer_processor", "unnormalizer_processor")


@dataclass(frozen=True)
class Recording:
    """Facts about a data set or a checkpoint.

    Attributes:
        what: name in messages.
        robot_type: name of the robot, empty if unknown.
        names: names of the values of an action, empty if unknown.
        statistics: LeRobot's statistics by feature and kind: {"action": {"max": (n,), …}, "observation.state": …}.
        config: saved policy config of a checkpoint, empty without one.
    """

    what: str
    robot_type: str = ""
    names: tuple[str, ...] = ()
    statistics: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    config: Mapping[str, Any] = field(default_factory=dict)

    def largest(self, which: np.ndarray) -> float | None:
        """Return the maximum magnitude in the statistics; None without statistics of matching length.

        which: (n,) whether each value of an action counts; a state begins with the values of an action.
        """
        n, found = len(which), []
        for feature in (ACTION, OBS_STATE):
            for kind in _STATISTICS:
                values = np.ravel(self.statistics.get(feature, {}).get(kind, ()))
                if len(values) == n or (len(values) > n and feature != ACTION):
                    found.append(float(np.abs(values[:n][which]).max(initial=0.0)))
        return max(found, default=None)


def unit_of(recording: Recording, is_joint: np.ndarray) -> str | None:
    """Return the unit of the joints, or None if unknown.

    is_joint: (n,) whether each value of an action is an angle; the other values are gripper openings.
    """
    if recording.robot_type.endswith(DEGREES_SUFFIX):
        return DEGREES
    largest = recording.largest(is_joint)
    if largest is None:
        return RADIANS if recording.robot_type in _OURS else None
    return DEGREES if largest > TURN else RADIANS


def recorded_name(device: str, use_degrees: bool, action_space: str) -> str:
    """Return the name of a robot in data sets, which encodes the unit and the action space.

    lerobot-record itself compares these names when it resumes a data set. End-effector poses are always in m and rad.
    """
    if action_space == "ee":
        return device + _TOOL_SUFFIX
    return device + DEGREES_SUFFIX if use_degrees else device


def of_dataset(repo_id: str, root: str | None) -> Recording:
    """Return facts about a data set (LeRobot's `dataset.repo_id`, `dataset.root`); empty if it cannot be read."""
    from lerobot.datasets import LeRobotDatasetMetadata

    what = f"data set {root or repo_id}"
    try:
        meta = LeRobotDatasetMetadata(repo_id, root=root)
    except Exception as error:  # LeRobot reports the reason when it opens the data set next
        logger.debug("%s: %s", what, error)
        return Recording(what)
    return Recording(what, meta.robot_type or "", value_names(meta.features.get(ACTION, {})), meta.stats or {})


def of_checkpoint(path: str, revision: str | None) -> Recording:
    """Return facts about a checkpoint (a directory or a repository on the hub); empty if it cannot be read."""
    data, config = _trained_on(path, revision), _json(path, "config.json", revision)
    names = tuple(config.get("action_feature_names") or value_names(data.get("features", {}).get(ACTION, {})))
    robot_type = data.get("robot_type") or ""
    return Recording(f"checkpoint {path}", robot_type, names, _statistics(path, revision), config)


def _trained_on(path: str, revision: str | None) -> dict[str, Any]:
    """Return LeRobot's description of a policy's data set, empty if the data set is not on this computer."""
    trained = _json(path, "train_config.json", revision).get("dataset") or {}
    root = trained.get("root") or HF_LEROBOT_HOME / (trained.get("repo_id") or "")
    return _json(str(root), "meta/info.json", None) if Path(root).is_dir() else {}


def _statistics(path: str, revision: str | None) -> dict[str, dict[str, np.ndarray]]:
    """Return the normalisation statistics saved with the policy's pre- and post-processors."""
    from safetensors.numpy import load_file

    statistics: dict[str, dict[str, np.ndarray]] = {}
    for pipeline in _PIPELINES:
        for step in _json(path, pipeline, revision).get("steps", []):
            state = step.get("state_file") if step.get("registry_name") in _NORMALISERS else None
            tensors = _file(path, state, revision) if state else None
            for key, value in load_file(tensors).items() if tensors else []:
                feature, _, statistic = key.rpartition(".")
                statistics.setdefault(feature, {})[statistic] = value
    return statistics


def _json(path: str, name: str, revision: str | None) -> dict[str, Any]:
    """Read a JSON object of a checkpoint or data set, empty without such a file."""
    file = _file(path, name, revision)
    return json.loads(file.read_text()) if file else {}


def _file(path: str, name: str, revision: str | None) -> Path | None:
    """Return the path of a checkpoint's file; None if it is missing or the hub cannot be reached."""
    if Path(path).is_dir():
        file = Path(path) / name
        return file if file.is_file() else None
    from huggingface_hub import hf_hub_download

    try:
        return Path(hf_hub_download(repo_id=path, filename=name, revision=revision))
    except Exception as error:  # no such file, no network, or not a repository name
        logger.debug("checkpoint %s: %s", path, error)
        return None
