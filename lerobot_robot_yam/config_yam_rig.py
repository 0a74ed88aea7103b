"""LeRobot config of the robot that a rig's file describes (`--robot.type=yam_rig --robot.file=rig.yaml`)."""

from dataclasses import dataclass
from typing import Any

from lerobot.robots.config import RobotConfig

from lerobot_robot_yam.arm.option import option
from lerobot_robot_yam.face.registration import register_as
from lerobot_robot_yam.system.rig_file import RIG_TYPE


@register_as(RobotConfig, RIG_TYPE)
@dataclass(kw_only=True)
class YamRigConfig(RobotConfig):
    """Making one gives the config that the file describes, of its own type. So LeRobot meets no robot of this type."""

    file: str = option("the rig's file, as yam-setup writes it; its `robot` is taken")
    options: dict[str, Any] = option("options laid over the file's, such as {use_degrees: true}", factory=dict)
    arm_options: dict[str, Any] = option(
        "options laid over those of each arm, such as {speed_limit_rad_s: 1.0}", factory=dict
    )
    cameras: bool = option("false: without the file's cameras", True)

    def __new__(cls, **given: Any) -> RobotConfig:  # returns a config of the type in the file
        # imported late, to keep LeRobot's start quick
        from lerobot_robot_yam.face.lerobot_command.config_refusal import rig_device

        return rig_device(RobotConfig, "robot", given)
