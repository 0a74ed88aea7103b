"""LeRobot config of two leader arms (`--teleop.type=bi_yam_leader`)."""

from dataclasses import dataclass

from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_robot_yam.face.registration import register_as
from lerobot_teleoperator_yam.leader_options import LeaderArmConfig, LeaderOptions


@register_as(TeleoperatorConfig, "bi_yam_leader", spare="bi_i2rt_yam_leader")
@dataclass(kw_only=True)
class BiYamLeaderConfig(TeleoperatorConfig, LeaderOptions):
    """Two leader arms."""

    left_arm_config: LeaderArmConfig
    right_arm_config: LeaderArmConfig

    def arms(self) -> dict[str, LeaderArmConfig]:
        """The sides by prefix, in canonical order."""
        return {"left_": self.left_arm_config, "right_": self.right_arm_config}


@register_as(TeleoperatorConfig, "bi_i2rt_yam_leader")
class BiI2rtYamLeaderConfig(BiYamLeaderConfig):
    """The same by a name that no other plugin claims."""
