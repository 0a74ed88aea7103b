"""LeRobot configs of one leader arm (`--teleop.type=yam_leader`) and of two (`bi_yam_leader`)."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.face.registration import register_as


@dataclass(kw_only=True)
class LeaderArmConfig(ArmConfig):
    """Every field of `ArmConfig`, with a leader's defaults.

    Attributes:
        follower_arm: profile whose joint limits the leader's action keeps, so that what LeRobot records is what the
            follower is sent; None: the same as this arm's.
        ee_gripper: the follower's end effector. Without a motor, a handle's action has no gripper; and its tool's pose
            is the action where `action_space` is "ee".
    """

    gripper: str = "yam_teaching_handle"
    start: Literal["hold", "float"] = "float"
    follower_arm: str | None = None
    ee_gripper: str = "linear_4310"

    def __post_init__(self) -> None:
        """No checks yet: they come when the teleoperator is made. The parser would hide what they say."""


@dataclass(kw_only=True)
class LeaderOptions(ABC):
    """Options of a leader, one arm or two.

    Attributes:
        use_degrees: joints in degrees in actions and feedback; as the follower's option of this name.
        action_space: "joint": actions and feedback are `joint_1.pos` …; "ee": they are the pose of the *follower's*
            tool, `ee_x.pos` …; as the follower's option of this name.
        isolation: "process" runs the control loop in another process; "thread" is for debugging.
    """

    use_degrees: bool = False
    action_space: Literal["joint", "ee"] = "joint"
    isolation: Literal["process", "thread"] = "process"

    @abstractmethod
    def arms(self) -> Mapping[str, LeaderArmConfig]:
        """The arms by feature prefix, in canonical order."""


@register_as(TeleoperatorConfig, "yam_leader", spare="i2rt_yam_leader")
@dataclass(kw_only=True)
class YamLeaderConfig(TeleoperatorConfig, LeaderOptions, LeaderArmConfig):
    """One leader arm: LeRobot's fields, `LeaderOptions`, and every field of `LeaderArmConfig`."""

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

    def arms(self) -> dict[str, LeaderArmConfig]:
        return {"left_": self.left_arm_config, "right_": self.right_arm_config}


@register_as(TeleoperatorConfig, "bi_i2rt_yam_leader")
class BiI2rtYamLeaderConfig(BiYamLeaderConfig):
    """The same by a name that no other plugin claims."""
