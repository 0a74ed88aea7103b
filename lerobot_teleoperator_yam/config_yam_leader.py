"""LeRobot configs of one leader arm (`--teleop.type=yam_leader`) and of two (`bi_yam_leader`)."""

from dataclasses import dataclass

from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_robot_yam.face.registration import register_as
from lerobot_teleoperator_yam.leader_options import LeaderArmConfig, LeaderOptions, refuse_leader


@register_as(TeleoperatorConfig, "yam_leader", spare="i2rt_yam_leader")
@dataclass(kw_only=True)
class YamLeaderConfig(TeleoperatorConfig, LeaderOptions, LeaderArmConfig):
    """One leader arm: LeRobot's fields, `LeaderOptions`, and every field of `LeaderArmConfig`."""

    def __post_init__(self) -> None:
        refuse_leader("yam_leader", self)

    def arms(self) -> dict[str, LeaderArmConfig]:
        return {"": self}


@register_as(TeleoperatorConfig, "i2rt_yam_leader")
class I2rtYamLeaderConfig(YamLeaderConfig):
    """The same by a name that no other plugin claims."""


@register_as(TeleoperatorConfig, "bi_yam_leader", spare="bi_i2rt_yam_leader")
@dataclass(kw_only=True)
class BiYamLeaderConfig(TeleoperatorConfig, LeaderOptions):
    """Two leader arms."""

    left_arm_config: LeaderArmConfig
    right_arm_config: LeaderArmConfig

    def __post_init__(self) -> None:
        refuse_leader("bi_yam_leader", self)

    def arms(self) -> dict[str, LeaderArmConfig]:
        return {"left_": self.left_arm_config, "right_": self.right_arm_config}


@register_as(TeleoperatorConfig, "bi_i2rt_yam_leader")
class BiI2rtYamLeaderConfig(BiYamLeaderConfig):
    """The same by a name that no other plugin claims."""
