"""LeRobot config of a camera that the virtual rig renders (`type: yam_sim`)."""

from dataclasses import dataclass, field
from typing import Any

from lerobot.cameras.configs import CameraConfig

from lerobot_robot_yam.face.registration import register_as


@register_as(CameraConfig, "yam_sim")
@dataclass(kw_only=True)
class YamSimCameraConfig(CameraConfig):
    """A camera of the virtual rig's scene.

    Attributes:
        camera: its name in the scene (`top`, `wrist_left`, `wrist_right` in the default one).
        fps, width, height: of the images; software rendering manages three such cameras on two cores.
        rig: which rig: "auto" is that of the robot's arms; without any, that of this process, unless the variable
            YAM_RIG names another.
        scene, rig_options: of a rig that this camera starts if there is none yet; unset: as the arms say.
    """

    camera: str
    fps: int | None = 30
    width: int | None = 320
    height: int | None = 240
    rig: str = "auto"
    scene: str | None = None
    rig_options: dict[str, Any] = field(default_factory=dict)
