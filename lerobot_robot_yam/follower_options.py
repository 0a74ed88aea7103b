"""What a follower shows LeRobot, one arm or two.

In a module of its own, so that no config module needs another one (see `registration`).
"""

from dataclasses import dataclass, field
from typing import Literal

from lerobot.cameras.configs import CameraConfig

from lerobot_robot_yam.arm.config import ArmConfig


@dataclass(kw_only=True)
class FollowerOptions:
    """Options of the robot as a whole.

    Attributes:
        cameras: any LeRobot cameras (opencv, intelrealsense, yam_sim, …).
        observe_velocity: also `joint_1.vel` …, rad/s; gripper in strokes per second.
        observe_torque: also `joint_1.torque` …, Nm at the motor's output.
        observe_temperature: also `joint_1.temp_mos`, `joint_1.temp_rotor` …, °C.
        use_degrees: joints in degrees (and degrees per second) in observations and actions; the gripper stays 0 … 1.
            Fields of this config keep their units.
        isolation: "process" runs the control loop in a process of its own; "thread" is for debugging.
    """

    cameras: dict[str, CameraConfig] = field(default_factory=dict)
    observe_velocity: bool = False
    observe_torque: bool = False
    observe_temperature: bool = False
    use_degrees: bool = False
    isolation: Literal["process", "thread"] = "process"


@dataclass(kw_only=True)
class FollowerArmConfig(ArmConfig):
    """One side of two: every field of `ArmConfig`, and cameras whose names get the side's prefix."""

    cameras: dict[str, CameraConfig] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """No checks yet: they come when the robot is made. The parser would hide what they say."""
