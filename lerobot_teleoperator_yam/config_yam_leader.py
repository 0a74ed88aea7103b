"""LeRobot configs of leader arms.

yam_leader, bi_yam_leader                  one arm, two arms
yam_remote_leader, bi_yam_remote_leader    one arm, two arms on another computer
yam_rig                                    arms described by a rig file
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_robot_yam.arm.option import option
from lerobot_robot_yam.face.devices.remote_device import RemoteOptions
from lerobot_robot_yam.face.registration import register_as
from lerobot_robot_yam.system.rig_file import RIG_TYPE
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
    """`YamLeaderConfig` under a type name that no other plugin claims."""


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
    """`BiYamLeaderConfig` under a type name that no other plugin claims."""


class _RemoteLeaders(RemoteOptions, LeaderOptions):
    """Options of leaders whose arms are described by the host."""

    def arms(self) -> Mapping[str, LeaderArmConfig]:
        return {prefix: LeaderArmConfig(**options) for prefix, options in self.hosted.options.items()}


@register_as(TeleoperatorConfig, "yam_remote_leader")
@dataclass(kw_only=True)
class YamRemoteLeaderConfig(TeleoperatorConfig, _RemoteLeaders):
    """One leader arm on another computer."""

    def __post_init__(self) -> None:
        self.ask_host("teleop", ("",))
        refuse_leader("yam_remote_leader", self)


@register_as(TeleoperatorConfig, "bi_yam_remote_leader")
@dataclass(kw_only=True)
class BiYamRemoteLeaderConfig(TeleoperatorConfig, _RemoteLeaders):
    """Two leader arms on another computer."""

    def __post_init__(self) -> None:
        self.ask_host("teleop", ("left_", "right_"))
        refuse_leader("bi_yam_remote_leader", self)


@register_as(TeleoperatorConfig, RIG_TYPE)
@dataclass(kw_only=True)
class YamRigLeadersConfig(TeleoperatorConfig):
    """Config that a rig's file describes. The constructor returns a config of the type named in the file."""

    file: str = option("the rig's file, as yam-setup writes it; its `teleop` is taken")
    options: dict[str, Any] = option("options laid over the file's, such as {buttons: record}", factory=dict)
    arm_options: dict[str, Any] = option("options laid over those of each arm, such as {gate: auto}", factory=dict)

    def __new__(cls, **given: Any) -> TeleoperatorConfig:  # returns a config of the type in the file
        # late import, to keep LeRobot's start quick
        from lerobot_robot_yam.face.lerobot_command.config_refusal import rig_device

        return rig_device(TeleoperatorConfig, "teleop", given)
