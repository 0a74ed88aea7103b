"""The LeRobot config that a rig's file describes (`system.rig_file`), decoded as LeRobot's parser would."""

from collections.abc import Mapping
from typing import Any

import draccus
from draccus.utils import DraccusException

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.devices.config_refusal import RefusedConfigError
from lerobot_robot_yam.system.rig_file import RIG_TYPE, device_of


def rig_device[C](registry: type[C], section: str, given: Mapping[str, Any]) -> C:
    """The config of the device that a run config names by the rig's file.

    Args:
        registry: LeRobot's base class of such configs.
        section: "robot" or "teleop".
        given: options of `yam_rig`, see `device_of`.

    Raises:
        RefusedConfigError: no such file or device, or a mistake in it; names the file.
    """
    try:
        return draccus.decode(registry, device_of(section, {"type": RIG_TYPE, **given}))
    except ConfigError as error:
        where = f"{given.get('file')}, {section}: "
        message = str(error)
        raise RefusedConfigError(message if str(given.get("file")) in message else where + message) from error
    except DraccusException as error:
        raise RefusedConfigError(f"{given.get('file')}, {section}: {error}") from error
