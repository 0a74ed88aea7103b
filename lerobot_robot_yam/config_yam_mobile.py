"""LeRobot configs of robots with a mobile base.

yam_base      the base alone
yam_mobile    the base with two arms
"""

import dataclasses
from dataclasses import dataclass

from lerobot.robots.config import RobotConfig

from lerobot_robot_yam.arm.config_checks import check_switches
from lerobot_robot_yam.config_yam_follower import BiYamFollowerConfig, CameraOptions, refuse_follower
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.registration import register_as
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.robot_options import BaseOptions, RobotOptions


@register_as(RobotConfig, "yam_base")
@dataclass(kw_only=True)
class YamBaseRobotConfig(RobotConfig, CameraOptions, RobotOptions, BaseOptions, BaseConfig):
    """A mobile base alone: LeRobot's fields, `RobotOptions`, `BaseOptions`, and every field of `BaseConfig`."""

    def __post_init__(self) -> None:
        # late imports, for a fast start of LeRobot
        from lerobot_robot_yam.face.lerobot_command.command_checks import check_cli
        from lerobot_robot_yam.face.lerobot_command.config_refusal import RefusedConfigError

        try:
            RobotConfig.__post_init__(self)
            check_switches("yam_base", self)
            check_cli("yam_base", self.base_keys(), False, self.image_names())
        except (ConfigError, ValueError, TypeError) as error:
            raise RefusedConfigError(str(error)) from error

    def base(self) -> BaseConfig:
        return base_config(self)


@dataclass(kw_only=True)
class MobileBaseConfig(BaseConfig):
    """Config of the base of a robot with arms: every field of `BaseConfig`."""

    def __post_init__(self) -> None:
        """Postpone the checks, so that LeRobot's parser prints one line about a mistake."""


@register_as(RobotConfig, "yam_mobile")
@dataclass(kw_only=True)
class YamMobileConfig(BiYamFollowerConfig, BaseOptions):
    """A mobile base with two follower arms: every option of `bi_yam_follower`, and the base."""

    base_config: MobileBaseConfig

    def __post_init__(self) -> None:
        refuse_follower("yam_mobile", self)

    def base(self) -> BaseConfig:
        if self.base_config is None:
            raise ConfigError("yam_mobile: base_config is empty: give it at least a channel")
        return base_config(self.base_config)

    def action_keys(self) -> list[str]:
        return super().action_keys() + self.base_keys()

    def state_keys(self) -> list[str]:
        return super().state_keys() + self.base_extra_keys()


def base_config(options: BaseConfig) -> BaseConfig:
    """Check a LeRobot config that extends `BaseConfig`, and return the base's part of it. Raises ConfigError."""
    return BaseConfig(**{field.name: getattr(options, field.name) for field in dataclasses.fields(BaseConfig)})
