"""Checks of a LeRobot config of arms while LeRobot's parser still reads the config, with one-line errors.

An error in a device's constructor would be printed by LeRobot as a line of 2,000 characters that ends with the cause.
"""

import dataclasses
import difflib
import typing
from collections.abc import Callable, Mapping
from typing import Any

import draccus
from draccus.utils import DecodingError, DraccusException

from lerobot_robot_yam.arm.config import ArmConfig, LeadArmConfig, check_together
from lerobot_robot_yam.arm.config_checks import check_switches
from lerobot_robot_yam.arm.leaders.lead_config import LeadOptions
from lerobot_robot_yam.arm.leaders.passive_config import PassiveOptions
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.rig_file import ARMS_OF_TWO, BASE, RIG_TYPE, device_of

_DEFAULT_NAME = ArmConfig(channel="any").name


class RefusedConfigError(ConfigError, DecodingError):
    """`ConfigError` that a LeRobot command prints as one line before it ends."""

    def __init__(self, message: str):
        DecodingError.__init__(self, (), message)

    def __reduce__(self) -> tuple[type, tuple[str]]:
        return type(self), (self.message,)


def arm_config(options: ArmConfig | PassiveOptions, name: str) -> ArmConfig:
    """Check a LeRobot config that extends `ArmConfig`, and return the arm layer's part of it.

    Args:
        options: the LeRobot config of one arm.
        name: the arm's name in messages, unless the user has named the arm.

    Raises:
        ConfigError: a value is not allowed; the message names the arm, the field, and the allowed values.
    """
    lead = options.lead_config() if isinstance(options, LeadOptions) else None
    names = [field.name for field in dataclasses.fields(ArmConfig)]
    values: dict[str, Any] = {field: getattr(options, field) for field in names if hasattr(options, field)}
    if options.name == _DEFAULT_NAME:
        values["name"] = name
    if isinstance(options, PassiveOptions):
        return LeadArmConfig(**values, lead=lead, passive=options.passive_config())
    return ArmConfig(**values) if lead is None else LeadArmConfig(**values, lead=lead)


def refuse(device: str, options: Any, role: str, check: Callable[[Mapping[str, ResolvedArm]], None]) -> None:
    """Raise RefusedConfigError if a device cannot be built from a config.

    Args:
        device: LeRobot's type name.
        options: the config, which has `arms()`.
        role: "follower" or "leader".
        check: function with further checks, called with prefix → arm.

    Raises:
        RefusedConfigError: the config has a mistake; the message describes the first mistake.
    """
    try:
        check_switches(device, options)
        arms = options.arms()
        for prefix, arm in arms.items():
            if arm is None:
                raise ConfigError(f"{prefix}arm_config is empty: give it at least a channel")
        resolved = {prefix: ResolvedArm(arm_config(arm, f"{prefix}{role}")) for prefix, arm in arms.items()}
        check_together([arm.config for arm in resolved.values()])
        check(resolved)
    except (ConfigError, ValueError, TypeError) as error:
        raise RefusedConfigError(str(error)) from error


def rig_device[C](registry: type[C], section: str, given: Mapping[str, Any]) -> C:
    """Return the config of a device that a run config specifies by the rig's file.

    Args:
        registry: LeRobot's base class of such configs.
        section: "robot" or "teleop".
        given: options of `yam_rig`, see `device_of`.

    Raises:
        RefusedConfigError: the file or device does not exist, or the device has a mistake; the message names the file.
    """
    try:
        return draccus.decode(registry, device_of(section, {"type": RIG_TYPE, **given}))
    except ConfigError as error:
        where = f"{given.get('file')}, {section}: "
        message = str(error)
        raise RefusedConfigError(message if str(given.get("file")) in message else where + message) from error
    except DraccusException as error:
        raise RefusedConfigError(f"{given.get('file')}, {section}: {error}") from error


def check_options(section: str, device: Mapping[str, Any], where: str, config: Any = None) -> None:
    """Check that LeRobot's parser knows all options of a device.

    Args:
        section: "robot" or "teleop".
        device: options of one of this package's types.
        where: location of the device, for messages.
        config: dataclass with the options; None: LeRobot's class of that type, which takes seconds to load.

    Raises:
        ConfigError: an option is unknown; the message names the option and the most similar known option.
    """
    if config is None:
        from lerobot.robots.config import RobotConfig  # only LeRobot's commands have already loaded this module
        from lerobot.teleoperators.config import TeleoperatorConfig

        registry: Any = RobotConfig if section == "robot" else TeleoperatorConfig
        config = registry.get_choice_class(device["type"])
    places: list[tuple[str, Any, Mapping[str, Any]]] = [(where, config, device)]
    hints = typing.get_type_hints(config)
    places += [
        (f"{where}, {arm}", hints[arm], device[arm])
        for arm in (*ARMS_OF_TWO, BASE)
        if arm in hints and isinstance(device.get(arm), Mapping)
    ]
    for place, known_by, given in places:
        known = {field.name for field in dataclasses.fields(known_by)} | ({"type"} if known_by is config else set())
        for name in map(str, given):
            if name not in known:
                near = difflib.get_close_matches(name, sorted(known), 1)
                raise ConfigError(f"{place}: there is no option {name!r}" + (f"; {near[0]!r}?" if near else ""))
