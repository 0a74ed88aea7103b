"""Camera of the virtual rig as a LeRobot camera."""

from typing import Any

import numpy as np
from lerobot.cameras.camera import Camera
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected

from lerobot_robot_yam.config_yam_camera import YamSimCameraConfig
from lerobot_robot_yam.rig.client.rendered_camera import RigCamera
from lerobot_robot_yam.rig.lockstep.lockstep_cameras import LockstepCamera
from lerobot_robot_yam.rig.lockstep.lockstep_rig import find_lockstep
from lerobot_robot_yam.rig.scene.scene import load_scene


class YamSimCamera(Camera):
    """Camera with images (height, width, 3) uint8 RGB that the rig renders in another process."""

    def __init__(self, config: YamSimCameraConfig):
        super().__init__(config)
        self.config = config
        size = (config.width or 320, config.height or 240, config.fps or 30)
        lockstep = find_lockstep(config.rig)
        self._camera: RigCamera | LockstepCamera
        if lockstep is not None:
            self._camera = LockstepCamera(lockstep, config.camera, *size)
        else:
            rig = None if config.rig == "auto" else config.rig  # with None, RigCamera also reads the variable YAM_RIG
            self._camera = RigCamera(config.camera, *size, rig=rig, scene=config.scene, options=config.rig_options)

    def __str__(self) -> str:
        return f"YamSimCamera({self.config.camera})"

    @property
    def is_connected(self) -> bool:
        return self._camera.is_connected

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        """List the cameras of the default scene."""
        return [
            {"name": camera.name, "type": "yam_sim", "id": camera.name, "default_fps": 30}
            for camera in load_scene().cameras
        ]

    @check_if_already_connected
    def connect(self, warmup: bool = True) -> None:
        """Connect to the rig, or start a rig, and wait for the first image. `warmup` has no effect.

        Raises:
            ConfigError: there is no such camera, or the camera does not support this size and rate.
            RigError: the rig cannot be started or reached, or has no OpenGL.
        """
        self._camera.connect()

    @check_if_not_connected
    def read(self) -> np.ndarray:
        """Wait for the next image not yet returned. Raises StaleStateError: no image within 1 s."""
        return self._camera.wait_new(1.0)[0]

    @check_if_not_connected
    def async_read(self, timeout_ms: float = 200) -> np.ndarray:
        """Wait for the next image not yet returned. Raises StaleStateError (a TimeoutError): no image in time."""
        return self._camera.wait_new(timeout_ms / 1e3)[0]

    @check_if_not_connected
    def read_latest(self, max_age_ms: int = 500) -> np.ndarray:
        """Return the newest image without waiting, as a writable copy.

        Raises:
            StaleStateError (a TimeoutError): the newest image is older than max_age_ms.
        """
        return self._camera.latest(max_age_ms / 1e3)[0]

    def disconnect(self) -> None:
        """Disconnect from the rig. Idempotent."""
        self._camera.close()
