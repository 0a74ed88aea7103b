"""Joints or tool poses: which of them the actions of a data set or checkpoint are, and the refusal to take one for the
other. Of an arm with six joints both are as many numbers, so that nothing else would notice.

- The names of the values tell, wherever they are kept.
- Statistics tell some joints: no tool of these arms gets 1.5 m away from its base, and joints get beyond 1.5 rad.
"""

import logging
from collections.abc import Sequence

import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.datasets.recording import Recording
from lerobot_robot_yam.face.devices.feature_names import TOOL_NUMBERS, space_of

logger = logging.getLogger(__name__)

_NAMES = {"joint": "joint positions", "ee": "tool poses"}
_OTHER_ROBOT = "Set the robot's type, and each arm's gripper, to those of the recording"
_OTHER_ORDER = "Convert the recording to this robot's order; a policy is then to be trained anew"
_FARTHEST_M = 1.5
_METRES = tuple(f"{name}.pos" for name in TOOL_NUMBERS[:3])


def check_names(device: str, keys: Sequence[str], data: Recording, in_order: bool) -> None:
    """Refuse a data set, or what has learnt from one, whose actions are not this robot's.

    Args:
        device: for messages.
        keys: of the robot's action, in canonical order.
        data: the data set.
        in_order: it is going to be continued, so that the order counts too.

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

    Args:
        device: for messages.
        keys: of the robot's action, in canonical order.
        recording: a data set or a checkpoint.

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
