"""LeRobot configs of robots with a mobile base.

yam_base      the base alone
yam_mobile    the base with two arms
"""

import dataclasses
from dataclasses import dataclass

from lerobot.robots.config import RobotConfig

from lerobot_robot_yam.arm.config_checks import check_switches
from lerobot_robot_yam.arm.option import option
from lerobot_robot_yam.config_yam_follower import RobotOptions
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.registration import register_as
from lerobot_robot_yam.mobile.base_config import BaseConfig


@dataclass(kw_only=True)
class BaseOptions:
    """Options of a robot with a base, as a whole."""

    observe_odometry: bool = option("also observe x.pos, y.pos, m, and theta.pos, degrees, from the wheels", False)
    observe_wheels: bool = option(
        "also observe the casters, rear_left_steer.pos …, rad, and the wheels, rear_left_drive.vel …, rad/s", False
    )


@register_as(RobotConfig, "yam_base")
@dataclass(kw_only=True)
class YamBaseRobotConfig(RobotConfig, RobotOptions, BaseOptions, BaseConfig):
    """A mobile base alone: LeRobot's fields, `RobotOptions`, `BaseOptions`, and every field of `BaseConfig`."""

    def __post_init__(self) -> None:
        # late imports, for a fast start of LeRobot
        from lerobot_robot_yam.face.lerobot_command.command_checks import check_cli
        from lerobot_robot_yam.face.lerobot_command.config_refusal import RefusedConfigError

        try:
            RobotConfig.__post_init__(self)
            check_switches("yam_base", self)
            base_config(self)
            check_cli("yam_base", self.action_keys(), False, self.image_names())
        except (ConfigError, ValueError, TypeError) as error:
            raise RefusedConfigError(str(error)) from error

    def action_keys(self) -> list[str]:
        """Return the action keys, in canonical order."""
        from lerobot_robot_yam.face.devices.base_part import VELOCITY_KEYS

        return list(VELOCITY_KEYS)


def base_config(options: BaseConfig) -> BaseConfig:
    """Check a LeRobot config that extends `BaseConfig`, and return the base's part of it. Raises ConfigError."""
    return BaseConfig(**{field.name: getattr(options, field.name) for field in dataclasses.fields(BaseConfig)})
