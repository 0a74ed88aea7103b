"""LeRobot configs of follower arms.

yam_follower, bi_yam_follower    one arm, two arms
yam_remote, bi_yam_remote        one arm, two arms connected to another computer
yam_rig                          arms described in a rig file (`--robot.type=yam_rig --robot.file=rig.yaml`)
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from lerobot.cameras.configs import CameraConfig
from lerobot.robots.config import RobotConfig

from lerobot_robot_yam.arm.config import ArmConfig, check_together
from lerobot_robot_yam.arm.option import option
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.devices.remote_device import RemoteOptions
from lerobot_robot_yam.face.registration import register_as
from lerobot_robot_yam.mobile.base_config import BASE_PREFIX
from lerobot_robot_yam.robot_options import FollowerOptions
from lerobot_robot_yam.system.rig_file import RIG_TYPE

_CAMERAS = (
    "LeRobot cameras of any type (opencv, yam_realsense, yam_sim, …); those of one arm get left_ or right_ in front"
)


@dataclass(kw_only=True)
class CameraOptions:
    """Cameras of a robot."""

    cameras: dict[str, CameraConfig] = option(_CAMERAS, factory=dict)

    def all_cameras(self) -> dict[str, CameraConfig]:
        """Return the configs of all cameras by the names of their images in observations.

        Raises:
            ConfigError: two cameras have the same name, or a camera has no size or rate.
        """
        return dict(self.cameras)

    def image_names(self) -> list[str]:
        """Return the names of all images; depth is `<name>_depth`. Raises ConfigError, see `all_cameras`."""
        names = []
        for name, camera in self.all_cameras().items():
            names += [name] * getattr(camera, "use_rgb", True) + [f"{name}_depth"] * getattr(camera, "use_depth", False)
        return names


def refuse_follower(device: str, config: Any) -> None:
    """Raise RefusedConfigError if a robot cannot be created from `config`."""
    # late imports, for a fast start of LeRobot
    from lerobot_robot_yam.face.lerobot_command.command_checks import check_cli
    from lerobot_robot_yam.face.lerobot_command.config_refusal import refuse

    def check(arms: Mapping[str, Any]) -> None:
        RobotConfig.__post_init__(config)
        if (base := config.base()) is not None:
            check_together([*(arm.config for arm in arms.values()), base])
        joints_in_degrees = config.use_degrees and config.action_space == "joint"
        check_cli(device, config.action_keys(), joints_in_degrees, config.image_names())

    refuse(device, config, "follower", check)


@dataclass(kw_only=True)
class FollowerArmConfig(ArmConfig):
    """Config of one of two arms: every field of `ArmConfig`, and cameras, whose names get the arm's prefix."""

    cameras: dict[str, CameraConfig] = option(_CAMERAS, factory=dict)

    def __post_init__(self) -> None:
        """Postpone the checks until both arms and their sides are known."""


@register_as(RobotConfig, "yam_follower", spare="i2rt_yam_follower")
@dataclass(kw_only=True)
class YamFollowerConfig(RobotConfig, CameraOptions, FollowerOptions, ArmConfig):
    """One follower arm: LeRobot's fields, `FollowerOptions`, and every field of `ArmConfig` (channel, gripper, …)."""

    def __post_init__(self) -> None:
        refuse_follower("yam_follower", self)

    def arms(self) -> dict[str, ArmConfig]:
        return {"": self}


@register_as(RobotConfig, "i2rt_yam_follower")
class I2rtYamFollowerConfig(YamFollowerConfig):
    """`YamFollowerConfig` with a type name that no other plugin uses."""


@register_as(RobotConfig, "bi_yam_follower", spare="bi_i2rt_yam_follower")
@dataclass(kw_only=True)
class BiYamFollowerConfig(RobotConfig, CameraOptions, FollowerOptions):
    """Two follower arms. Camera names in an arm's own config get the prefix `left_` or `right_`, others do not."""

    left_arm_config: FollowerArmConfig
    right_arm_config: FollowerArmConfig

    def __post_init__(self) -> None:
        refuse_follower("bi_yam_follower", self)

    def arms(self) -> dict[str, FollowerArmConfig]:
        return {"left_": self.left_arm_config, "right_": self.right_arm_config}

    def all_cameras(self) -> dict[str, CameraConfig]:
        cameras = dict(self.cameras)
        for prefix, arm in self.arms().items():
            for name, camera in arm.cameras.items():
                if f"{prefix}{name}" in cameras:
                    raise ConfigError(f"two cameras are called {prefix}{name}; rename one")
                cameras[f"{prefix}{name}"] = camera
        for name, camera in cameras.items():
            if None in (camera.width, camera.height, camera.fps):
                raise ConfigError(f"camera {name}: give width, height and fps")
        return cameras


@register_as(RobotConfig, "bi_i2rt_yam_follower")
class BiI2rtYamFollowerConfig(BiYamFollowerConfig):
    """`BiYamFollowerConfig` with a type name that no other plugin uses."""


class RemoteFollowers(RemoteOptions, CameraOptions, FollowerOptions):
    """Options of followers whose arms are described by the host."""

    def arms(self) -> Mapping[str, ArmConfig]:
        options = self.hosted.options.items()
        return {prefix: ArmConfig(**fields) for prefix, fields in options if prefix != BASE_PREFIX}


@register_as(RobotConfig, "yam_remote")
@dataclass(kw_only=True)
class YamRemoteConfig(RobotConfig, RemoteFollowers):
    """One follower arm connected to another computer, with cameras connected to this computer."""

    def __post_init__(self) -> None:
        self.ask_host("robot", ("",))
        refuse_follower("yam_remote", self)


@register_as(RobotConfig, "bi_yam_remote")
@dataclass(kw_only=True)
class BiYamRemoteConfig(RobotConfig, RemoteFollowers):
    """Two follower arms connected to another computer, with cameras connected to this computer."""

    def __post_init__(self) -> None:
        self.ask_host("robot", ("left_", "right_"))
        refuse_follower("bi_yam_remote", self)


@register_as(RobotConfig, RIG_TYPE)
@dataclass(kw_only=True)
class YamRigConfig(RobotConfig):
    """Config read from a rig file. The constructor returns a config of the type in the file, not of this type."""

    file: str = option("the rig's file, as yam-setup writes it; its `robot` is taken")
    options: dict[str, Any] = option("options laid over the file's, such as {use_degrees: true}", factory=dict)
    arm_options: dict[str, Any] = option(
        "options laid over those of each arm, such as {speed_limit_rad_s: 1.0}", factory=dict
    )
    cameras: bool = option("false: without the file's cameras", True)

    def __new__(cls, **given: Any) -> RobotConfig:  # returns a config of the type in the file
        # late import, for a fast start of LeRobot
        from lerobot_robot_yam.face.lerobot_command.config_refusal import rig_device

        return rig_device(RobotConfig, "robot", given)
