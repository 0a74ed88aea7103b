"""LeRobot config of one leader arm (`--teleop.type=yam_leader`)."""

from dataclasses import dataclass

from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_teleoperator_yam.leader_options import LeaderArmConfig, LeaderOptions


@TeleoperatorConfig.register_subclass("yam_leader")
@dataclass(kw_only=True)
class YamLeaderConfig(TeleoperatorConfig, LeaderOptions, LeaderArmConfig):
    """One leader arm: LeRobot's fields, `LeaderOptions`, and every field of `LeaderArmConfig`."""
