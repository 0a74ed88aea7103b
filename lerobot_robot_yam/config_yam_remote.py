"""LeRobot configs of followers that another computer has: one (`--robot.type=yam_remote`), two (`bi_yam_remote`)."""

from collections.abc import Mapping
from dataclasses import dataclass

from lerobot.robots.config import RobotConfig

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.face.devices.remote_device import RemoteOptions
from lerobot_robot_yam.face.registration import register_as
from lerobot_robot_yam.follower_options import FollowerOptions, refuse_follower


class _RemoteFollowers(RemoteOptions, FollowerOptions):
    """Options of followers whose arms the host describes."""

    def arms(self) -> Mapping[str, ArmConfig]:
        return {prefix: ArmConfig(**options) for prefix, options in self.hosted.options.items()}


@register_as(RobotConfig, "yam_remote")
@dataclass(kw_only=True)
class YamRemoteConfig(RobotConfig, _RemoteFollowers):
    """One follower arm of another computer. `cameras` are this computer's."""

    def __post_init__(self) -> None:
        self.ask_host("robot", ("",))
        refuse_follower("yam_remote", self)


@register_as(RobotConfig, "bi_yam_remote")
@dataclass(kw_only=True)
class BiYamRemoteConfig(RobotConfig, _RemoteFollowers):
    """Two follower arms of another computer. `cameras` are this computer's."""

    def __post_init__(self) -> None:
        self.ask_host("robot", ("left_", "right_"))
        refuse_follower("bi_yam_remote", self)
