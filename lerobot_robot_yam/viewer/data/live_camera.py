"""Cameras that can be looked through: those of a run config, and those of virtual rigs that run on this computer."""

import logging
import threading
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lerobot_robot_yam.arm.config import VIRTUAL, ArmConfig
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.rig.client.told_scene import told_scene
from lerobot_robot_yam.system.runtime_files import runtime_dir

logger = logging.getLogger(__name__)

_RIG, _SOCKET = "rig-", ".sock"  # around a rig's name, of the file of its socket
_PICTURES = {
    "width": 640,
    "height": 480,
    "fps": 10,
}  # of a rig's camera: the picture is to be compared, not to be quick
_WAIT_MS = 1000.0


def running_rigs() -> list[str]:
    """Names of the rigs that run for this user."""
    return sorted(path.name[len(_RIG) : -len(_SOCKET)] for path in runtime_dir().glob(f"{_RIG}*{_SOCKET}"))


def rig_cameras(rig: str) -> dict[str, dict[str, Any]]:
    """LeRobot's options of the cameras of a rig, by a name that tells the rig; empty once it has ended.

    The rig is asked nothing: a question would start one anew that was killed.
    """
    try:
        names = [camera.name for camera in told_scene(rig).cameras]
    except YamError as error:
        logger.debug("rig %s: %s", rig, error)
        return {}
    return {f"{rig}: {name}": {"type": VIRTUAL, "camera": name, "rig": rig, **_PICTURES} for name in names}


class LiveCamera:
    """Looks through one camera, in a thread.

    Args:
        name: what messages call it.
        options: as in a run config.
        arms: of that config.

    Attributes:
        picture: (height, width, 3) uint8 RGB, the newest one; None before the first.
        trouble: why there is none any more; empty if there is.
    """

    def __init__(self, name: str, options: Mapping[str, Any], arms: Sequence[ArmConfig] = ()):
        self.picture: np.ndarray | None = None
        self.trouble = ""
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(name, options, arms), name="yam-view-camera")
        self._thread.start()

    def _run(self, name: str, options: Mapping[str, Any], arms: Sequence[ArmConfig]) -> None:
        from lerobot_robot_yam.face.devices.images import open_camera  # LeRobot: seconds

        try:
            camera = open_camera(name, options, arms)
        except YamError as error:
            self.trouble = str(error)
            return
        try:
            while not self._ending.is_set():
                self.picture = camera.async_read(timeout_ms=_WAIT_MS)
        except Exception as error:  # drivers raise anything
            self.trouble = f"camera {name}: {error}"
        finally:
            camera.disconnect()

    def begin_close(self) -> None:
        """Have it end, without waiting."""
        self._ending.set()

    def close(self) -> None:
        """Disconnect the camera. Idempotent."""
        self.begin_close()
        self._thread.join()
