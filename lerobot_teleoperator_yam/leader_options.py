"""Options of a leader, one arm or two.

In a separate module, so that no config module needs another one (see `lerobot_robot_yam.face.registration`).
"""

from dataclasses import dataclass
from typing import Literal

from lerobot_robot_yam.arm.config import ArmConfig


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
class LeaderOptions:
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
