"""Degrees or radians: in which of them a data set or checkpoint is, and the refusal to move by the wrong one.

- A data set names its robot: ours is called `bi_yam_follower_degrees` there while it gives degrees. So does a
  checkpoint whose data set is still on this computer.
- A data set and a checkpoint hold statistics of the joints. No joint of these arms gets a whole turn away from zero:
  larger numbers are degrees, and a data set that has none is in radians (or of an arm that never left zero by 6°).
"""

import logging

import numpy as np

from lerobot_robot_yam.arm.joint_map import TURN
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.datasets.recording import DEGREES_SUFFIX, Recording

logger = logging.getLogger(__name__)

RADIANS, DEGREES = "radians", "degrees"
_OURS = ("yam_follower", "bi_yam_follower")


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

    Args:
        device: for messages.
        use_degrees: the robot's option.
        what: what the command is going to use.
        found: its unit, None if it does not tell.

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
