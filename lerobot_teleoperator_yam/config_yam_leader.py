"""LeRobot config of one leader arm (`--teleop.type=yam_leader`)."""

from dataclasses import dataclass

from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_robot_yam.face.registration import register_as
from lerobot_teleoperator_yam.leader_options import LeaderArmConfig, LeaderOptions


@register_as(TeleoperatorConfig, "yam_leader", spare="i2rt_yam_leader")
@dataclass(kw_only=True)
class YamLeaderConfig(TeleoperatorConfig, LeaderOptions, LeaderArmConfig):
    """One leader arm: LeRobot's fields, `LeaderOptions`, and every field of `LeaderArmConfig`."""


@register_as(TeleoperatorConfig, "i2rt_yam_leader")
class I2rtYamLeaderConfig(YamLeaderConfig):
    """The same by a name that no other plugin claims."""
