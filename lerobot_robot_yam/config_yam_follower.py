"""LeRobot configs of one follower arm (`--robot.type=yam_follower`) and of two (`bi_yam_follower`)."""

from dataclasses import dataclass

from lerobot.cameras.configs import CameraConfig
from lerobot.robots.config import RobotConfig

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.option import option
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.registration import register_as
from lerobot_robot_yam.follower_options import FollowerOptions, refuse_follower


@dataclass(kw_only=True)
class FollowerArmConfig(ArmConfig):
    """One side of two: every field of `ArmConfig`, and cameras whose names get the side's prefix."""

    cameras: dict[str, CameraConfig] = option(
        "LeRobot cameras of any type (opencv, yam_realsense, yam_sim, …); those of one arm get left_ or right_ "
        "in front",
        factory=dict,
    )

    def __post_init__(self) -> None:
        """Postpone the checks until both arms are known, with their sides."""


@register_as(RobotConfig, "yam_follower", spare="i2rt_yam_follower")
@dataclass(kw_only=True)
class YamFollowerConfig(RobotConfig, FollowerOptions, ArmConfig):
    """One follower arm: LeRobot's fields, `FollowerOptions`, and every field of `ArmConfig` (channel, gripper, …)."""

    def __post_init__(self) -> None:
        refuse_follower("yam_follower", self)

    def arms(self) -> dict[str, ArmConfig]:
        return {"": self}


@register_as(RobotConfig, "i2rt_yam_follower")
class I2rtYamFollowerConfig(YamFollowerConfig):
    """The same by a name that no other plugin claims."""


@register_as(RobotConfig, "bi_yam_follower", spare="bi_i2rt_yam_follower")
@dataclass(kw_only=True)
class BiYamFollowerConfig(RobotConfig, FollowerOptions):
    """Two follower arms. `cameras` keep their names, those of an arm get `left_` or `right_` in front."""

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
    """The same by a name that no other plugin claims."""
