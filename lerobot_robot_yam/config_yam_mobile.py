"""LeRobot configs of robots with a mobile base.

yam_base      the base alone
yam_mobile    the base with two arms
"""

import dataclasses
from dataclasses import dataclass

from lerobot.robots.config import RobotConfig

from lerobot_robot_yam.arm.config_checks import check_switches
from lerobot_robot_yam.arm.option import option
from lerobot_robot_yam.config_yam_follower import BiYamFollowerConfig, RobotOptions, refuse_follower
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.registration import register_as
from lerobot_robot_yam.mobile.base_config import BaseConfig


@dataclass(kw_only=True)
class BaseOptions:
    """Options of a robot with a base, as a whole, besides those of the base itself."""

    observe_odometry: bool = option("also observe x.pos, y.pos, m, and theta.pos, degrees, from the wheels", False)
    observe_wheels: bool = option(
        "also observe the casters, rear_left_steer.pos …, rad, and the wheels, rear_left_drive.vel …, rad/s", False
    )
    replay_poses: bool = option(
        "lerobot-replay keeps to the recorded poses: it corrects the recorded velocities by the odometry. The data set "
        "has to be recorded with observe_odometry",
        False,
    )

    def base_keys(self) -> list[str]:
        """Return the keys of the base's part of an action."""
        from lerobot_robot_yam.face.devices.base_part import VELOCITY_KEYS  # late import, for a fast start

        return list(VELOCITY_KEYS)

    def base_extra_keys(self) -> list[str]:
        """Return the keys of the optional numbers of the base that are enabled."""
        from lerobot_robot_yam.face.devices.base_part import optional_keys

        return optional_keys(self.observe_odometry, self.observe_wheels)


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
            check_cli("yam_base", self.base_keys(), False, self.image_names())
        except (ConfigError, ValueError, TypeError) as error:
            raise RefusedConfigError(str(error)) from error


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
