"""Options of a follower, one arm or two.

In a separate module, so that no config module needs another one (see `registration`).
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from lerobot.cameras.configs import CameraConfig

from lerobot_robot_yam.arm.config import ArmConfig


@dataclass(kw_only=True)
class FollowerOptions(ABC):
    """Options of the robot as a whole.

    Attributes:
        cameras: any LeRobot cameras (opencv, intelrealsense, yam_sim, …).
        observe_velocity: also `joint_1.vel` …, rad/s; gripper in strokes per second.
        observe_torque: also `joint_1.torque` …, Nm at the motor's output.
        observe_temperature: also `joint_1.temp_mos`, `joint_1.temp_rotor` …, °C.
        use_degrees: joints in degrees (and degrees per second) in observations and actions; the gripper stays 0 … 1.
            Fields of this config keep their units.
        action_space: "joint": actions and observed positions are `joint_1.pos` …; "ee": they are the tool's pose,
            `ee_x.pos` … in m and rad, velocities in rad/s, whatever `use_degrees` says (docs/end-effector.md).
        isolation: "process" runs the control loop in another process; "thread" is for debugging,
            "lockstep" for rigs in lock-step (the environment `yam` sets it).
    """

    cameras: dict[str, CameraConfig] = field(default_factory=dict)
    observe_velocity: bool = False
    observe_torque: bool = False
    observe_temperature: bool = False
    use_degrees: bool = False
    action_space: Literal["joint", "ee"] = "joint"
    isolation: Literal["process", "thread", "lockstep"] = "process"

    @abstractmethod
    def arms(self) -> Mapping[str, ArmConfig]:
        """The arms by feature prefix, in canonical order."""

    def all_cameras(self) -> dict[str, CameraConfig]:
        """Every camera under the name that its images have in observations."""
        return dict(self.cameras)

    def action_keys(self) -> list[str]:
        """Keys of an action, in canonical order.

        Raises:
            ConfigError: unknown arm or gripper.
        """
        from lerobot_robot_yam.face.devices.feature_names import (  # profiles cost LeRobot's start too much
            position_keys,
            tool_keys,
        )

        return (tool_keys if self.action_space == "ee" else position_keys)(self.arms())

    def state_keys(self) -> list[str]:
        """Keys of all numbers of an observation: those of an action, then the optional ones."""
        from lerobot_robot_yam.face.devices.feature_names import extra_keys, motors_of

        kinds = self.observe_velocity, self.observe_torque, self.observe_temperature
        return self.action_keys() + extra_keys(motors_of(self.arms()), *kinds)


@dataclass(kw_only=True)
class FollowerArmConfig(ArmConfig):
    """One side of two: every field of `ArmConfig`, and cameras whose names get the side's prefix."""

    cameras: dict[str, CameraConfig] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """No checks yet: they come when the robot is made. The parser would hide what they say."""
