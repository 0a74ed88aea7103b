"""LeRobot config of two leader arms (`--teleop.type=bi_yam_leader`)."""

from dataclasses import dataclass

from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_teleoperator_yam.leader_options import LeaderArmConfig, LeaderOptions


@TeleoperatorConfig.register_subclass("bi_yam_leader")
@dataclass(kw_only=True)
class BiYamLeaderConfig(TeleoperatorConfig, LeaderOptions):
    """Two leader arms."""

    left_arm_config: LeaderArmConfig
    right_arm_config: LeaderArmConfig

    def arms(self) -> dict[str, LeaderArmConfig]:
        """The sides by prefix, in canonical order."""
        return {"left_": self.left_arm_config, "right_": self.right_arm_config}
