"""The LeRobot config that a rig's file describes (`system.rig_file`), decoded as LeRobot's parser would."""

import dataclasses
import difflib
import typing
from collections.abc import Mapping
from typing import Any

import draccus
from draccus.utils import DraccusException

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.devices.config_refusal import RefusedConfigError
from lerobot_robot_yam.system.rig_file import ARMS_OF_TWO, RIG_TYPE, device_of


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


def check_options(section: str, device: Mapping[str, Any], where: str) -> None:
    """Refuse an option that LeRobot's parser would not know.

    Args:
        section: "robot" or "teleop".
        device: options of one of our types.
        where: place of the device, for messages.

    Raises:
        ConfigError: names the option, and one that is like it.
    """
    from lerobot.robots.config import RobotConfig  # loaded before this module by LeRobot's commands only
    from lerobot.teleoperators.config import TeleoperatorConfig

    registry: Any = RobotConfig if section == "robot" else TeleoperatorConfig
    config = registry.get_choice_class(device["type"])
    places: list[tuple[str, Any, Mapping[str, Any]]] = [(where, config, device)]
    hints = typing.get_type_hints(config)
    places += [
        (f"{where}, {arm}", hints[arm], device[arm]) for arm in ARMS_OF_TWO if isinstance(device.get(arm), Mapping)
    ]
    for place, known_by, given in places:
        known = {field.name for field in dataclasses.fields(known_by)} | ({"type"} if known_by is config else set())
        for name in map(str, given):
            if name not in known:
                near = difflib.get_close_matches(name, sorted(known), 1)
                raise ConfigError(f"{place}: there is no option {name!r}" + (f"; {near[0]!r}?" if near else ""))
