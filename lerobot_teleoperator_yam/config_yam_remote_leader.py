"""LeRobot configs of leaders that another computer has: one (`yam_remote_leader`), two (`bi_yam_remote_leader`)."""

from collections.abc import Mapping
from dataclasses import dataclass

from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_robot_yam.face.devices.remote_device import RemoteOptions
from lerobot_robot_yam.face.registration import register_as
from lerobot_teleoperator_yam.leader_options import LeaderArmConfig, LeaderOptions, refuse_leader


class _RemoteLeaders(RemoteOptions, LeaderOptions):
    """Options of leaders whose arms the host describes."""

    def arms(self) -> Mapping[str, LeaderArmConfig]:
        return {prefix: LeaderArmConfig(**options) for prefix, options in self.hosted.options.items()}


@register_as(TeleoperatorConfig, "yam_remote_leader")
@dataclass(kw_only=True)
class YamRemoteLeaderConfig(TeleoperatorConfig, _RemoteLeaders):
    """One leader arm of another computer."""

    def __post_init__(self) -> None:
        self.ask_host("teleop", ("",))
        refuse_leader("yam_remote_leader", self)


@register_as(TeleoperatorConfig, "bi_yam_remote_leader")
@dataclass(kw_only=True)
class BiYamRemoteLeaderConfig(TeleoperatorConfig, _RemoteLeaders):
    """Two leader arms of another computer."""

    def __post_init__(self) -> None:
        self.ask_host("teleop", ("left_", "right_"))
        refuse_leader("bi_yam_remote_leader", self)
