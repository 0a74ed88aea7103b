"""The check of the recording or policy that the running LeRobot command will use, before anything is energised.

No stock loop tells the robot what it is about to replay, resume or roll out. So the robot reads the command's options
with LeRobot's own parser: the command line, and the file of `--config_path` below it.

Joints or tool poses: of an arm with six joints both are as many numbers, so that nothing else would notice.

- The names of the values tell, wherever they are kept.
- Statistics tell some joints: no tool of these arms gets 1.5 m away from its base, and joints get beyond 1.5 rad.

Degrees or radians:

- A data set names its robot: ours is called `bi_yam_follower_degrees` there while it gives degrees. So does a
  checkpoint whose data set is still on this computer.
- Statistics tell: no joint of these arms gets a whole turn away from zero. Larger numbers are degrees; without any,
  the recording is in radians (or of an arm that never left zero by 6°).
"""

import logging
import sys
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.configs import parser

from lerobot_robot_yam.arm.joint_map import TURN
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.datasets.layout import DEGREES_SUFFIX
from lerobot_robot_yam.face.datasets.recording import Recording, of_checkpoint, of_dataset
from lerobot_robot_yam.face.devices.cli_inputs import check_cameras, check_channels, check_data_set
from lerobot_robot_yam.face.devices.cli_options import given_options
from lerobot_robot_yam.face.devices.feature_names import TOOL_NUMBERS, space_of

logger = logging.getLogger(__name__)

_TRAINING = ("lerobot-train", "lerobot_train")
_IN_ENVS = (*_TRAINING, "lerobot-eval", "lerobot_eval")  # whose cameras an environment names
_SERVER_SPACES = {"joint_position": "joint", "cartesian_position": "ee"}  # RoboArena's words
_NAMES = {"joint": "joint positions", "ee": "tool poses"}
_OTHER_ROBOT = "Set the robot's type, and each arm's gripper, to those of the recording"
_OTHER_ORDER = "Convert the recording to this robot's order, and train a policy anew"
_FARTHEST_M = 1.5
_METRES = tuple(f"{name}.pos" for name in TOOL_NUMBERS[:3])
_RADIANS, _DEGREES = "radians", "degrees"
_OURS = ("yam_follower", "bi_yam_follower")


def check_cli(device: str, keys: Sequence[str], use_degrees: bool, cameras: Collection[str] = ()) -> None:
    """Refuse a LeRobot command that cannot work, or that replays, resumes or rolls out numbers of another meaning.

    Args:
        device: LeRobot's type name.
        keys: of an action.
        use_degrees: of the robot.
        cameras: names of the robot's images.

    Raises:
        ConfigError: an arm's channel is given twice; there is no such data set or episode, or one where a new one is
            to be; the policy sees cameras that the robot lacks; it is of other values, of tool poses instead of joints
            (or the reverse), or in the other unit.
    """
    space, options = space_of(keys), given_options()
    check_channels()
    check_data_set(options)
    recordings = []
    replays, resumes = "dataset.episode" in options, options.get("resume") == "True"
    repo_id = options.get("dataset.repo_id")
    if repo_id and (replays or resumes):
        data = of_dataset(repo_id, options.get("dataset.root"))
        _check_names(device, keys, data, in_order=resumes)
        recordings.append(data)
    path = parser.get_path_arg("policy") or options.get("pretrained_name_or_path")  # the latter: async inference
    if Path(*sys.argv[:1]).stem in _TRAINING:
        path = None  # from where the training begins; its evaluations roll out what has been learnt since
    revision = options.get("policy.pretrained_revision")
    if path:
        learnt = of_checkpoint(path, revision)
        if not any(name.startswith("rename_map") for name in options) and Path(*sys.argv[:1]).stem not in _IN_ENVS:
            check_cameras(learnt.what, learnt.config, cameras)
        if set(learnt.names) == set(keys):  # LeRobot goes by the order then, not by the names
            _check_names(device, keys, learnt, in_order=True)
        recordings.append(learnt)
    if space is None:  # a gripper alone
        return
    is_joint = np.array([not key.endswith("gripper.pos") for key in keys])
    for recording in recordings:
        _check_space(device, keys, recording)
        if space == "joint":  # poses of a tool have one unit
            _check_unit(device, use_degrees, recording.what, unit_of(recording, is_joint))
    saved = learnt.config if path else {}
    if options.get("policy.type", saved.get("type")) == "yam_openpi":
        _check_server(device, keys, use_degrees, saved, options)


def _check_server(
    device: str, keys: Sequence[str], use_degrees: bool, saved: Mapping[str, Any], options: Mapping[str, str]
) -> None:
    """The same for what the options of a yam_openpi policy, or its saved config, say of its server."""
    from lerobot_robot_yam.face.openpi.configuration_openpi import YamOpenpiConfig

    space = options.get("policy.action_space") or saved.get("action_space") or YamOpenpiConfig.action_space
    _refuse_other_space(device, keys, f"policy.action_space={space}", _SERVER_SPACES[space])
    degrees = (options.get("policy.angle_unit") or saved.get("angle_unit")) == "deg"
    if space_of(keys) == "joint":
        _check_unit(device, use_degrees, "policy.angle_unit", _DEGREES if degrees else _RADIANS)
    elif degrees:
        raise ConfigError(f"{device}: tool poses are in m and rad; nothing was energised. Set policy.angle_unit to rad")


def _check_names(device: str, keys: Sequence[str], data: Recording, in_order: bool) -> None:
    """Refuse a data set, or what has learnt from one, whose actions have other names than this robot's."""
    held = list(data.names)
    if not held or held == list(keys) or (not in_order and set(held) == set(keys)):
        return
    _refuse_other_space(device, keys, data.what, space_of(held))
    differing, remedy = ", ".join(sorted(set(held) ^ set(keys))), _OTHER_ROBOT
    if not differing:
        differing, remedy = "their order", _OTHER_ORDER
    raise ConfigError(
        f"{device}: {data.what} has other actions than this robot, they differ in {differing}; nothing was energised. "
        f"{remedy}"
    )


def _check_space(device: str, keys: Sequence[str], recording: Recording) -> None:
    """Refuse joints where the robot takes poses, and poses where it takes joints; warn of what does not tell."""
    ours, found = space_of(keys), space_of(recording.names)
    if found is None and ours == "ee":
        largest = recording.largest(np.array([key.endswith(_METRES) for key in keys]))
        found = "joint" if largest is not None and largest > _FARTHEST_M else None
    _refuse_other_space(device, keys, recording.what, found)
    if found is None and ours is not None:
        logger.warning(
            "%s: %s does not tell joints from tool poses; this robot takes %s", device, recording.what, _NAMES[ours]
        )


def _refuse_other_space(device: str, keys: Sequence[str], what: str, found: str | None) -> None:
    """Refuse `what`, whose actions are `found` ("joint" or "ee"; None if it does not tell), if the robot's are not."""
    ours = space_of(keys)
    if found is not None and ours is not None and found != ours:
        raise ConfigError(
            f"{device}: {what} is of {_NAMES[found]}, this robot takes {_NAMES[ours]}; nothing was energised. "
            f"Set the robot's action_space to {found}"
        )


def unit_of(recording: Recording, is_joint: np.ndarray) -> str | None:
    """Unit of the joints, None if the recording does not tell.

    Args:
        recording: a data set or a checkpoint.
        is_joint: (n,) which values of an action are angles; the others are grippers.
    """
    if recording.robot_type.endswith(DEGREES_SUFFIX):
        return _DEGREES
    largest = recording.largest(is_joint)
    if largest is None:
        return _RADIANS if recording.robot_type in _OURS else None
    return _DEGREES if largest > TURN else _RADIANS


def _check_unit(device: str, use_degrees: bool, what: str, found: str | None) -> None:
    """Refuse what is in the other unit; warn of what does not tell."""
    unit = _DEGREES if use_degrees else _RADIANS
    if found is None:
        logger.warning("%s: %s does not tell its unit; this robot is in %s", device, what, unit)
    elif found != unit:
        raise ConfigError(
            f"{device}: {what} is in {found}, this robot in {unit}; nothing was energised. "
            f"Set the robot's use_degrees to {str(found == _DEGREES).lower()}"
        )
