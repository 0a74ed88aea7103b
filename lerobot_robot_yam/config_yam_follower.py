"""LeRobot config of one follower arm (`--robot.type=yam_follower`)."""

from dataclasses import dataclass

from lerobot.robots.config import RobotConfig

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.face.devices.follower_options import FollowerOptions
from lerobot_robot_yam.face.registration import register_as


@register_as(RobotConfig, "yam_follower", spare="i2rt_yam_follower")
@dataclass(kw_only=True)
class YamFollowerConfig(RobotConfig, FollowerOptions, ArmConfig):
    """One follower arm: LeRobot's fields, `FollowerOptions`, and every field of `ArmConfig` (channel, gripper, …)."""

    def __post_init__(self) -> None:
        # Not ArmConfig's checks: they come when the robot is made. The parser would hide what they say.
        RobotConfig.__post_init__(self)

    def arms(self) -> dict[str, ArmConfig]:
        """The one arm, without a prefix."""
        return {"": self}


@register_as(RobotConfig, "i2rt_yam_follower")
class I2rtYamFollowerConfig(YamFollowerConfig):
    """The same by a name that no other plugin claims."""
