"""Checks of the options of a LeRobot command, before any device is opened or energised.

- Existence: the data set, the episode, the cameras of a policy, and a separate channel for each arm.
- Meaning: the numbers of a recording or policy must have the same meaning as the robot's. No LeRobot loop tells the
  robot what it is about to replay, resume or roll out, so the checks read the command's options. LeRobot decodes the
  options while it creates the robot's config; its parser has them, from command line and file, in a local variable.

Joints or end-effector poses: both are six numbers for an arm with six joints, so no other check would detect a mix-up.

- Names of the values decide, if they are stored anywhere.
- Otherwise statistics can show joints: no end effector gets 1.5 m away from its base, while joints exceed 1.5 rad.

Degrees or radians:

- A data set names its robot, and this package's robot names end in `_degrees` if angles are in degrees. The same holds
  for a checkpoint whose data set is still on this computer.
- Otherwise statistics decide: no joint of these arms gets a whole turn away from zero, so larger numbers are degrees.
  Without larger numbers the recording is in radians (or of an arm that never moved more than 6° from zero).
"""

import difflib
import logging
import sys
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from draccus import argparsing
from lerobot.configs import parser
from lerobot.utils.constants import OBS_IMAGES

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.datasets.layout import INFO, episodes_in, is_empty
from lerobot_robot_yam.face.datasets.recording import (
    DEGREES,
    RADIANS,
    Recording,
    of_checkpoint,
    of_dataset,
    unit_of,
)
from lerobot_robot_yam.face.devices.feature_names import JOINT, TOOL_NUMBERS, space_of
from lerobot_robot_yam.face.lerobot_command.running_command import callers
from lerobot_robot_yam.system.rig_file import ARMS_OF_TWO, BASE, device_of

logger = logging.getLogger(__name__)

_POLICY_OPTIONS = ("pretrained_revision", "action_space", "angle_unit")  # options that are checked
_HUB_S = 5.0  # maximum wait for the hub's reply, s
_PARQUET_END = b"PAR1"
_FILLED = "empty_camera"  # prefix of images that LeRobot fills with zeros
_FILLING = ("pi0", "pi05", "pi0_fast", "smolvla", "xvla", "evo1")  # policy types that fill any missing image
_SERVER_SPACES = {"joint_position": "joint", "cartesian_position": "ee"}  # RoboArena's word → action space
_NAMES = {"joint": "joint positions", "ee": "tool poses"}
_OTHER_ROBOT = "Set the robot's type, and each arm's gripper, to those of the recording"
_OTHER_ORDER = "Convert the recording to this robot's order, and train a policy anew"
_FARTHEST_M = 1.5
_METRES = tuple(f"{name}.pos" for name in TOOL_NUMBERS[:3])


def given_options() -> Mapping[str, Any]:
    """Return the options that LeRobot's parser is decoding, nested as in a config file; empty outside the parser."""
    for caller in callers():
        if caller.f_code.co_filename == argparsing.__file__ and "deflat_d" in caller.f_locals:
            return caller.f_locals["deflat_d"]
    return {}


def _section(options: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    found = options.get(name)
    return found if isinstance(found, Mapping) else {}  # LeRobot refuses anything else


def channels_of(device: str) -> dict[str, str]:
    """Return option name → channel for the arms and the base of a device ("robot", "teleop")."""
    try:
        told = device_of(device, _section(given_options(), device))
    except (ConfigError, TypeError):  # raised again when the device is created
        return {}
    parts = {"channel": told} | {f"{name}.channel": _section(told, name) for name in (*ARMS_OF_TWO, BASE)}
    return {f"{device}.{option}": str(part["channel"]) for option, part in parts.items() if part.get("channel")}


def check_cli(device: str, keys: Sequence[str], use_degrees: bool, cameras: Collection[str] = ()) -> None:
    """Check that a LeRobot command can work, and does not replay, resume or roll out numbers of another meaning.

    Args:
        device: LeRobot's type name.
        keys: keys of an action.
        use_degrees: whether the robot's joints are in degrees.
        cameras: names of the robot's images.

    Raises:
        ConfigError: two arms share a channel; the data set or episode does not exist, or a new data set would replace
            an old one; the policy needs cameras that the robot lacks; the values have other names, are end-effector
            poses instead of joints (or the reverse), or are in the other unit.
    """
    space, options = space_of(keys), given_options()
    command = Path(*sys.argv[:1]).stem.replace("_", "-")
    dataset, resumes = _section(options, "dataset"), options.get("resume") in (True, "true")
    opens = resumes or dataset.get("episode") is not None
    _check_channels()
    _check_data_set(dataset, opens, new=not opens and command == "lerobot-record")
    recordings: list[Recording] = []
    if opens and dataset.get("repo_id"):
        data = of_dataset(dataset["repo_id"], dataset.get("root"))
        _check_names(device, keys, data, in_order=resumes)
        recordings.append(data)
    policy = _policy_options(options)
    # pretrained_name_or_path is used in async inference
    path = parser.get_path_arg("policy") or options.get("pretrained_name_or_path")
    if path and command != "lerobot-train":  # lerobot-train evaluates newer weights
        learnt = of_checkpoint(path, policy.get("pretrained_revision"))
        policy = {**learnt.config, **policy}
        if not options.get("rename_map") and command != "lerobot-eval":
            _check_cameras(learnt, cameras)
        if set(learnt.names) == set(keys):  # in this case LeRobot uses the order, not the names
            _check_names(device, keys, learnt, in_order=True)
        recordings.append(learnt)
    if space is None:  # a gripper or a base alone
        return
    is_joint = np.array([JOINT.fullmatch(key) is not None for key in keys])
    for recording in recordings:
        _check_space(device, keys, recording)
        if space == "joint":  # end-effector poses have one unit
            _check_unit(device, use_degrees, recording.what, unit_of(recording, is_joint))
    if policy.get("type") == "yam_openpi":
        _check_server(device, keys, use_degrees, policy)


def _policy_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the policy's options. With `policy.path`, LeRobot's parser keeps these options undecoded, as words."""
    words = [*(parser.get_cli_overrides("policy") or ()), *parser.get_yaml_overrides("policy")]
    told = {name: parser.parse_arg(name, words) for name in _POLICY_OPTIONS}
    return {**_section(options, "policy"), **{name: value for name, value in told.items() if value is not None}}


def _check_channels() -> None:
    found: dict[str, str] = {}
    for device in ("robot", "teleop"):
        for option, channel in channels_of(device).items():
            if channel in found:
                raise ConfigError(
                    f"channel {channel} is given twice, by {found[channel]} and {option}; each part has its own"
                )
            found[channel] = option


def _check_data_set(dataset: Mapping[str, Any], opens: bool, new: bool) -> None:
    """Check `dataset.root`: it has the data set if the command opens one, or is new if the command creates one."""
    if not dataset.get("root"):
        return  # LeRobot's own directory, or the hub
    root = Path(str(dataset["root"]))
    episodes = episodes_in(root)
    if opens and episodes is None and not _on_hub(dataset.get("repo_id", "")):
        beside = sorted(path.parent.parent.name for path in root.parent.glob(f"*/{INFO}"))
        there = f"{root.parent} has {', '.join(beside)}" if beside else f"{root.parent} has none"
        raise ConfigError(f"there is no data set in {root}; {there}")
    if opens and episodes == 0:
        raise ConfigError(f"the data set in {root} has no episode; {_clean(root)}")
    if opens and episodes and _is_torn(root):
        raise ConfigError(f"the data set in {root} was not closed, and does not load; `yam-repair-dataset {root}`")
    episode = str(dataset.get("episode"))
    if episodes and episode.isdecimal() and int(episode) >= episodes:  # LeRobot refuses other text
        raise ConfigError(f"{root} has no episode {episode}, but 0 to {episodes - 1}")
    if new and root.exists():
        holds = f"holds {episodes} episodes; add --resume=true to record more, or choose another dataset.root"
        if episodes is None:
            holds = "is no data set; choose another dataset.root"
        elif episodes == 0:
            holds = f"holds no episode; {_clean(root)}"
        raise ConfigError(f"{root} is there already and {holds}")


def _is_torn(root: Path) -> bool:
    """Return whether the recording was killed. LeRobot would then search the Hub, without explanation."""
    episodes = list(root.glob("meta/episodes/**/*.parquet"))
    tables = [*episodes, *root.glob("data/**/*.parquet")]
    return not episodes or not all(_is_closed(path) for path in tables)


def _is_closed(table: Path) -> bool:
    with table.open("rb") as file:
        file.seek(max(0, table.stat().st_size - len(_PARQUET_END)))
        return file.read() == _PARQUET_END


def _clean(root: Path) -> str:
    """Return advice on removing a data set without an episode."""
    if is_empty(root):
        return f"remove it (rm -r {root}) and record"
    return f"there are rows or images of one all the same: `yam-repair-dataset {root}`"


def _on_hub(repo_id: str) -> bool:
    from huggingface_hub import HfApi

    try:
        HfApi().dataset_info(repo_id, timeout=_HUB_S)
    except Exception:  # no such data set, no network, or an invalid name
        return False
    return True


def _check_cameras(policy: Recording, cameras: Collection[str]) -> None:
    """Raise ConfigError if a policy needs cameras that the robot lacks. Some policies need only one camera."""
    config = policy.config
    names = [name.removeprefix(f"{OBS_IMAGES}.") for name in config.get("input_features") or {} if OBS_IMAGES in name]
    wanted = [name for name in names if not name.startswith(_FILLED)]
    missing = next((name for name in wanted if name not in cameras), None)
    if missing is None or (config.get("type") in _FILLING and not set(wanted).isdisjoint(cameras)):
        return
    near = difflib.get_close_matches(missing, list(cameras), 1)
    meant = f"is {near[0]!r} its {missing!r}? Rename it" if near else f"configure {missing!r} under robot.cameras"
    raise ConfigError(
        f"{policy.what} sees the cameras {', '.join(wanted)}, this robot has {', '.join(cameras) or 'none'}; {meant}"
    )


def _check_server(device: str, keys: Sequence[str], use_degrees: bool, policy: Mapping[str, Any]) -> None:
    """Check action space and unit in the options of a yam_openpi policy, or in its saved config."""
    from lerobot_robot_yam.face.openpi.configuration_openpi import YamOpenpiConfig

    space = policy.get("action_space") or YamOpenpiConfig.action_space
    _refuse_other_space(device, keys, f"policy.action_space={space}", _SERVER_SPACES[space])
    degrees = policy.get("angle_unit") == "deg"
    if space_of(keys) == "joint":
        _check_unit(device, use_degrees, "policy.angle_unit", DEGREES if degrees else RADIANS)
    elif degrees:
        raise ConfigError(f"{device}: tool poses are in m and rad; nothing was energised. Set policy.angle_unit to rad")


def _check_names(device: str, keys: Sequence[str], data: Recording, in_order: bool) -> None:
    """Raise ConfigError if the actions of a data set or checkpoint have other names than this robot's."""
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
    """Raise ConfigError if recording and robot differ in action space; warn if the recording's is unknown."""
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
    """Raise ConfigError if `what` has the action space `found` ("joint", "ee"; None: unknown) and the robot another."""
    ours = space_of(keys)
    if found is not None and ours is not None and found != ours:
        raise ConfigError(
            f"{device}: {what} is of {_NAMES[found]}, this robot takes {_NAMES[ours]}; nothing was energised. "
            f"Set the robot's action_space to {found}"
        )


def _check_unit(device: str, use_degrees: bool, what: str, found: str | None) -> None:
    """Raise ConfigError if the unit `found` is not the robot's; warn if the unit is unknown."""
    unit = DEGREES if use_degrees else RADIANS
    if found is None:
        logger.warning("%s: %s does not tell its unit; this robot is in %s", device, what, unit)
    elif found != unit:
        raise ConfigError(
            f"{device}: {what} is in {found}, this robot in {unit}; nothing was energised. "
            f"Set the robot's use_degrees to {str(found == DEGREES).lower()}"
        )
