"""Options of a robot as a whole, without LeRobot's: yam-host reads a rig's file by them, and loads no LeRobot."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.option import option
from lerobot_robot_yam.mobile.base_config import BaseConfig

if TYPE_CHECKING:
    from lerobot_robot_yam.session.arm_session import Isolation


@dataclass(kw_only=True)
class RobotOptions:
    """Options of every robot."""

    isolation: Literal["process", "thread", "lockstep"] = option(
        "process runs the control loop in another process; thread is for debugging; lockstep is set by the "
        "environment yam",
        "process",
    )

    def runs(self) -> "Isolation":
        """Return how the control loop is isolated, see `ArmSession`."""
        return self.isolation


@dataclass(kw_only=True)
class FollowerOptions(RobotOptions, ABC):
    """Options of the robot as a whole: with one arm or two, connected to this computer or to another one."""

    observe_velocity: bool = option("also observe joint_1.vel …, rad/s, and the gripper in strokes per second", False)
    observe_torque: bool = option(
        "also observe joint_1.torque …, Nm at the motor's output; LeRobot cannot roll out a policy that wants it", False
    )
    observe_temperature: bool = option(
        "also observe joint_1.temp_mos and joint_1.temp_rotor …, °C; LeRobot cannot roll out a policy that wants them",
        False,
    )
    use_degrees: bool = option(
        "joints in degrees (and degrees per second) in observations and actions; grippers stay 0 … 1, options "
        "keep their units",
        False,
    )
    action_space: Literal["joint", "ee"] = option(
        "joint: actions and observed positions are joint_1.pos …; ee: they are the tool's pose ee_x.pos …, m and "
        "rad (docs/end-effector.md)",
        "joint",
    )

    @abstractmethod
    def arms(self) -> Mapping[str, ArmConfig]:
        """Return the configs of the arms by feature prefix, in canonical order."""

    def base(self) -> BaseConfig | None:
        """Return the config of the base on which the arms ride, if any. Raises ConfigError: a value is impossible."""
        return None

    def action_keys(self) -> list[str]:
        """Return the action keys, in canonical order. Raises ConfigError: an arm or gripper is unknown."""
        from lerobot_robot_yam.face.devices import feature_names  # late import of profiles, for a fast start

        return feature_names.action_keys(self.arms(), self.action_space)

    def state_keys(self) -> list[str]:
        """Return the keys of all numbers in an observation: the action keys, then the optional keys."""
        from lerobot_robot_yam.face.devices.feature_names import motors_of

        return self.action_keys() + self.optional_keys(motors_of(self.arms()))

    def optional_keys(self, motors: Sequence[str]) -> list[str]:
        """Return the keys of the optional numbers that are enabled, for motors in canonical order."""
        kinds = ["vel"] * self.observe_velocity + ["torque"] * self.observe_torque
        kinds += ["temp_mos", "temp_rotor"] * self.observe_temperature
        return [f"{motor}.{kind}" for kind in kinds for motor in motors]


@dataclass(kw_only=True)
class BaseOptions:
    """Options of a robot with a base, as a whole, besides those of the base itself."""

    observe_odometry: bool = option("also observe x.pos, y.pos, m, and theta.pos, degrees, from the wheels", False)
    observe_wheels: bool = option(
        "also observe the casters, rear_left_steer.pos …, rad, and the wheels, rear_left_drive.vel …, rad/s", False
    )
    replay_poses: bool = option(
        "lerobot-replay keeps to the recorded poses: it corrects the recorded velocities by the odometry. The data set "
        "has to be recorded with observe_odometry",
        False,
    )

    rail_action: Literal["vel", "pos"] = option(
        "with a rail, what actions have: vel, its velocity height.vel, m/s; pos, its height height.pos, m", "vel"
    )

    def base(self) -> BaseConfig | None:
        """Return the config of the base, if it is known. Raises ConfigError: a value is impossible."""
        return None

    def base_keys(self) -> list[str]:
        """Return the keys of the base's part of an action."""
        from lerobot_robot_yam.face.devices.base_part import action_keys  # late import, for a fast start

        return action_keys(self._rail_action())

    def base_extra_keys(self) -> list[str]:
        """Return the keys of the other numbers of the base that are observed."""
        from lerobot_robot_yam.face.devices.base_part import extra_keys

        return extra_keys(self._rail_action(), self.observe_odometry, self.observe_wheels)

    def _rail_action(self) -> str | None:
        base = self.base()
        return None if base is None or base.rail is None else self.rail_action


@dataclass(kw_only=True)
class MobileOptions(FollowerOptions, BaseOptions):
    """Options of a base with arms, as a whole."""

    def action_keys(self) -> list[str]:
        return super().action_keys() + self.base_keys()

    def state_keys(self) -> list[str]:
        return super().state_keys() + self.base_extra_keys()
