"""Options of followers, one arm or two, of this computer or another one, and their checks.

Does not import LeRobot's robots, whose registry loads all configs at once.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from lerobot.cameras.configs import CameraConfig

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.option import option

if TYPE_CHECKING:
    from lerobot_robot_yam.session.arm_session import Isolation


@dataclass(kw_only=True)
class FollowerOptions(ABC):
    """Options of the robot as a whole."""

    cameras: dict[str, CameraConfig] = option(
        "LeRobot cameras of any type (opencv, yam_realsense, yam_sim, …); those of one arm get left_ or right_ "
        "in front",
        factory=dict,
    )
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
    isolation: Literal["process", "thread", "lockstep"] = option(
        "process runs the control loop in another process; thread is for debugging; lockstep is set by the "
        "environment yam",
        "process",
    )

    @abstractmethod
    def arms(self) -> Mapping[str, ArmConfig]:
        """Arms by feature prefix, in canonical order."""

    def runs(self) -> "Isolation":
        """Isolation of the control loop, see `ArmSession`."""
        return self.isolation

    def all_cameras(self) -> dict[str, CameraConfig]:
        """Every camera by the name of its images in observations.

        Raises:
            ConfigError: two cameras have the same name, or one lacks its size or rate.
        """
        return dict(self.cameras)

    def image_names(self) -> list[str]:
        """Names of all images of an observation; depth is `<name>_depth`. Raises ConfigError, see `all_cameras`."""
        names = []
        for name, camera in self.all_cameras().items():
            names += [name] * getattr(camera, "use_rgb", True) + [f"{name}_depth"] * getattr(camera, "use_depth", False)
        return names

    def action_keys(self) -> list[str]:
        """Keys of an action, in canonical order. Raises ConfigError: unknown arm or gripper."""
        from lerobot_robot_yam.face.devices import feature_names  # loads profiles: late, for a quick start

        return feature_names.action_keys(self.arms(), self.action_space)

    def state_keys(self) -> list[str]:
        """Keys of all numbers of an observation: the keys of an action, then the optional ones."""
        from lerobot_robot_yam.face.devices.feature_names import motors_of

        return self.action_keys() + self.optional_keys(motors_of(self.arms()))

    def optional_keys(self, motors: Sequence[str]) -> list[str]:
        """Keys of the optional numbers that are switched on, of motors in canonical order."""
        kinds = ["vel"] * self.observe_velocity + ["torque"] * self.observe_torque
        kinds += ["temp_mos", "temp_rotor"] * self.observe_temperature
        return [f"{motor}.{kind}" for kind in kinds for motor in motors]


def refuse_follower(device: str, config: Any) -> None:
    """Refuse a config from which no robot can be made. Raises RefusedConfigError."""
    from lerobot.robots.config import RobotConfig

    # imported late, to keep LeRobot's start quick
    from lerobot_robot_yam.face.lerobot_command.command_checks import check_cli
    from lerobot_robot_yam.face.lerobot_command.config_refusal import refuse

    def check(_: Any) -> None:
        RobotConfig.__post_init__(config)
        joints_in_degrees = config.use_degrees and config.action_space == "joint"
        check_cli(device, config.action_keys(), joints_in_degrees, config.image_names())

    refuse(device, config, "follower", check)
