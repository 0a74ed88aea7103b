"""What is wrong with a LeRobot config of arms, said while LeRobot's parser still reads it: in one line.

Of an error in a device's constructor, LeRobot makes a line of 2,000 characters that ends with the cause.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

from draccus.utils import DecodingError

from lerobot_robot_yam.arm.config import ArmConfig, LeadArmConfig, check_together
from lerobot_robot_yam.arm.config_checks import check_switches
from lerobot_robot_yam.arm.leaders.lead_config import LeadOptions
from lerobot_robot_yam.arm.leaders.passive_config import PassiveOptions
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.errors import ConfigError

_DEFAULT_NAME = ArmConfig(channel="any").name


class RefusedConfigError(ConfigError, DecodingError):
    """A `ConfigError` that LeRobot's commands print as one line, before they end."""

    def __init__(self, message: str):
        DecodingError.__init__(self, (), message)

    def __reduce__(self) -> tuple[type, tuple[str]]:
        return type(self), (self.message,)


def arm_config(options: ArmConfig | PassiveOptions, name: str) -> ArmConfig:
    """The arm layer's part of a LeRobot config that extends `ArmConfig`, checked.

    Args:
        options: the LeRobot config of one arm.
        name: what messages call the arm, unless the user has named it.

    Raises:
        ConfigError: names the arm, the field, and what it takes.
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
    """Refuse a config of which no device can be made.

    Args:
        device: LeRobot's type name.
        options: the config, which has `arms()`.
        role: "follower" or "leader".
        check: more checks, given the arms by prefix.

    Raises:
        RefusedConfigError: the first thing that is wrong.
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
