"""The meaning of recorded actions, and the refusal to move an arm by actions that it does not take.

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
from collections.abc import Sequence

import numpy as np

from lerobot_robot_yam.arm.joint_map import TURN
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.datasets.recording import DEGREES_SUFFIX, Recording
from lerobot_robot_yam.face.devices.feature_names import TOOL_NUMBERS, space_of

logger = logging.getLogger(__name__)

_NAMES = {"joint": "joint positions", "ee": "tool poses"}
_OTHER_ROBOT = "Set the robot's type, and each arm's gripper, to those of the recording"
_OTHER_ORDER = "Convert the recording to this robot's order; a policy is then to be trained anew"
_FARTHEST_M = 1.5
_METRES = tuple(f"{name}.pos" for name in TOOL_NUMBERS[:3])
RADIANS, DEGREES = "radians", "degrees"
_OURS = ("yam_follower", "bi_yam_follower")


def check_names(device: str, keys: Sequence[str], data: Recording, in_order: bool) -> None:
    """Refuse a data set, or what has learnt from one, whose actions are not this robot's.

    Raises:
        ConfigError: its actions have other names.
    """
    held = list(data.names)
    if not held or held == list(keys) or (not in_order and set(held) == set(keys)):
        return
    refuse_other_space(device, keys, data.what, space_of(held))
    differing, remedy = ", ".join(sorted(set(held) ^ set(keys))), _OTHER_ROBOT
    if not differing:
        differing, remedy = "their order", _OTHER_ORDER
    raise ConfigError(
        f"{device}: {data.what} has other actions than this robot, they differ in {differing}; nothing was energised. "
        f"{remedy}"
    )


def check_space(device: str, keys: Sequence[str], recording: Recording) -> None:
    """Refuse what is of the other space; warn of what does not tell.

    Raises:
        ConfigError: its actions are joints and the robot's poses, or the other way round.
    """
    ours, found = space_of(keys), space_of(recording.names)
    if found is None and ours == "ee":
        largest = recording.largest(np.array([key.endswith(_METRES) for key in keys]))
        found = "joint" if largest is not None and largest > _FARTHEST_M else None
    refuse_other_space(device, keys, recording.what, found)
    if found is None and ours is not None:
        logger.warning(
            "%s: %s does not tell joints from tool poses; this robot takes %s", device, recording.what, _NAMES[ours]
        )


def refuse_other_space(device: str, keys: Sequence[str], what: str, found: str | None) -> None:
    """Refuse `what`, whose actions are `found` ("joint" or "ee"; None if it does not tell), if the robot's are not.

    Raises:
        ConfigError: they are not.
    """
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
        return DEGREES
    largest = recording.largest(is_joint)
    if largest is None:
        return RADIANS if recording.robot_type in _OURS else None
    return DEGREES if largest > TURN else RADIANS


def check_unit(device: str, use_degrees: bool, what: str, found: str | None) -> None:
    """Refuse what is in the other unit; warn of what does not tell.

    Raises:
        ConfigError: it is in the other unit.
    """
    unit = DEGREES if use_degrees else RADIANS
    if found is None:
        logger.warning("%s: %s does not tell its unit; this robot is in %s", device, what, unit)
    elif found != unit:
        raise ConfigError(
            f"{device}: {what} is in {found}, this robot in {unit}; nothing was energised. "
            f"Set the robot's use_degrees to {str(found == DEGREES).lower()}"
        )
