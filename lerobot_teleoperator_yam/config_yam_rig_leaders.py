"""LeRobot config of the leaders that a rig's file describes (`--teleop.type=yam_rig --teleop.file=rig.yaml`)."""

from dataclasses import dataclass
from typing import Any

from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_robot_yam.arm.option import option
from lerobot_robot_yam.face.registration import register_as
from lerobot_robot_yam.system.rig_file import RIG_TYPE


@register_as(TeleoperatorConfig, RIG_TYPE)
@dataclass(kw_only=True)
class YamRigLeadersConfig(TeleoperatorConfig):
    """Making one gives the config that the file describes, of its own type."""

    file: str = option("the rig's file, as yam-setup writes it; its `teleop` is taken")
    options: dict[str, Any] = option("options laid over the file's, such as {buttons: record}", factory=dict)
    arm_options: dict[str, Any] = option("options laid over those of each arm, such as {gate: auto}", factory=dict)

    def __new__(cls, **given: Any) -> TeleoperatorConfig:  # returns a config of the type in the file
        # imported late, to keep LeRobot's start quick
        from lerobot_robot_yam.face.lerobot_command.config_refusal import rig_device

        return rig_device(TeleoperatorConfig, "teleop", given)
