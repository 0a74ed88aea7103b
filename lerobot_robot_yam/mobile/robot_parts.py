"""Parts of a robot, arms and a mobile base: resolved from configurations, and as plain values for JSON."""

import dataclasses
from typing import Any

from lerobot_robot_yam.arm.config import ArmConfig, LeadArmConfig
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.mobile.resolved_base import ResolvedBase

Part = ResolvedArm | ResolvedBase


def resolve(config: ArmConfig | BaseConfig) -> Part:
    """Resolve a configuration. Raises ConfigError: a name is unknown, or a value is out of range."""
    return ResolvedBase(config) if isinstance(config, BaseConfig) else ResolvedArm(config)


def plain(part: Part) -> tuple[str, dict[str, Any]]:
    """Return a part's kind and its configuration as plain values."""
    return ("base" if isinstance(part, ResolvedBase) else "arm"), dataclasses.asdict(part.config)


def part_of(kind: str, fields: dict[str, Any]) -> Part:
    """Resolve what `plain` has returned. Raises ConfigError: a file has changed since."""
    return resolve(config_of(kind, fields))


def config_of(kind: str, fields: dict[str, Any]) -> ArmConfig | BaseConfig:
    """Make a part's configuration from its kind, as of `plain`, and its fields. Raises ConfigError: see `resolve`."""
    return BaseConfig(**fields) if kind == "base" else LeadArmConfig(**fields)
