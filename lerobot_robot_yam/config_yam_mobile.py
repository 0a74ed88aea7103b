"""LeRobot configs of robots with a mobile base.

yam_base, yam_base_remote        the base alone, on this or another computer
yam_mobile, yam_mobile_remote    the base with two arms
"""

from dataclasses import dataclass

from lerobot.robots.config import RobotConfig

from lerobot_robot_yam.arm.config_checks import check_switches
from lerobot_robot_yam.config_yam_follower import (
    BiYamFollowerConfig,
    CameraOptions,
    RemoteFollowers,
    refuse_follower,
)
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.devices.remote_device import RemoteOptions
from lerobot_robot_yam.face.registration import register_as
from lerobot_robot_yam.mobile.base_config import BASE_PREFIX, BaseConfig
from lerobot_robot_yam.robot_options import BaseOptions, MobileOptions, RobotOptions


@register_as(RobotConfig, "yam_base")
@dataclass(kw_only=True)
class YamBaseRobotConfig(RobotConfig, CameraOptions, RobotOptions, BaseOptions, BaseConfig):
    """A mobile base alone: LeRobot's fields, `RobotOptions`, `BaseOptions`, and every field of `BaseConfig`."""

    def __post_init__(self) -> None:
        _refuse_base("yam_base", self)

    def base(self) -> BaseConfig:
        return self.checked()


@register_as(RobotConfig, "yam_base_remote")
@dataclass(kw_only=True)
class YamBaseRemoteConfig(RobotConfig, RemoteOptions, CameraOptions, RobotOptions, BaseOptions):
    """A mobile base alone, connected to another computer, with cameras connected to this computer."""

    def __post_init__(self) -> None:
        self.ask_host("robot", (BASE_PREFIX,))
        _refuse_base("yam_base_remote", self)


def _refuse_base(device: str, config: YamBaseRobotConfig | YamBaseRemoteConfig) -> None:
    """Raise RefusedConfigError if a base cannot be created from `config`."""
    # late imports, for a fast start of LeRobot
    from lerobot_robot_yam.face.lerobot_command.command_checks import check_cli
    from lerobot_robot_yam.face.lerobot_command.config_refusal import RefusedConfigError

    try:
        RobotConfig.__post_init__(config)
        check_switches(device, config)
        config.base()
        check_cli(device, config.base_keys(), False, config.image_names())
    except (ConfigError, ValueError, TypeError) as error:
        raise RefusedConfigError(str(error)) from error


@dataclass(kw_only=True)
class MobileBaseConfig(BaseConfig):
    """Config of the base of a robot with arms: every field of `BaseConfig`."""

    def __post_init__(self) -> None:
        """Postpone the checks, so that LeRobot's parser prints one line about a mistake."""


@register_as(RobotConfig, "yam_mobile")
@dataclass(kw_only=True)
class YamMobileConfig(BiYamFollowerConfig, MobileOptions):
    """A mobile base with two follower arms: every option of `bi_yam_follower`, and the base."""

    base_config: MobileBaseConfig

    def __post_init__(self) -> None:
        refuse_follower("yam_mobile", self)

    def base(self) -> BaseConfig:
        if self.base_config is None:
            raise ConfigError("yam_mobile: base_config is empty: give it at least a channel")
        return self.base_config.checked()


@register_as(RobotConfig, "yam_mobile_remote")
@dataclass(kw_only=True)
class YamMobileRemoteConfig(RobotConfig, RemoteFollowers, MobileOptions):
    """A mobile base with two arms, connected to another computer, with cameras connected to this computer."""

    def __post_init__(self) -> None:
        self.ask_host("robot", ("left_", "right_", BASE_PREFIX))
        refuse_follower("yam_mobile_remote", self)
