"""LeRobot config of a camera rendered by the virtual rig (`type: yam_sim`)."""

from dataclasses import dataclass
from typing import Any

from lerobot.cameras.configs import CameraConfig

from lerobot_robot_yam.arm.option import option
from lerobot_robot_yam.face.registration import register_as


@register_as(CameraConfig, "yam_sim")
@dataclass(kw_only=True)
class YamSimCameraConfig(CameraConfig):
    """A camera in the virtual rig's scene."""

    camera: str = option("its name in the scene: top, wrist_left, wrist_right, front or overview in the default one")
    fps: int | None = option("images per second; software rendering manages three such cameras on two cores", 30)
    width: int | None = option("of the images, pixels", 320)
    height: int | None = option("of the images, pixels", 240)
    rig: str = option(
        "auto: the rig of the robot's arms; without any, that of this process, unless the variable YAM_RIG names "
        "another",
        "auto",
    )
    scene: str | None = option(
        "of a rig that this camera starts if there is none yet; by default as the arms say", None
    )
    rig_options: dict[str, Any] = option("options of such a rig; by default as the arms say", factory=dict)
