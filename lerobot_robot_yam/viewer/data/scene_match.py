"""Overlay of a recorded picture on a camera's live picture, so that a person can restore the recorded scene.

The live camera belongs to a run config or to a virtual rig that runs on this computer.
"""

import html
import logging
import threading
from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
import viser

from lerobot_robot_yam.arm.config import VIRTUAL, ArmConfig
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.rig.client.launch import told_scene
from lerobot_robot_yam.system.runtime_files import runtime_dir
from lerobot_robot_yam.viewer.serving.handles import put

logger = logging.getLogger(__name__)

_NONE = "none"
_LOOK_S = 2.0  # period of searching for rigs, s
_SHOWN_S = 0.1
_RIG, _SOCKET = "rig-", ".sock"  # parts of a rig's socket file name before and after the rig's name
# Options for rendered cameras: good picture quality at a low rate.
_PICTURES = {"width": 640, "height": 480, "fps": 10}
_WAIT_MS = 1000.0


def running_rigs() -> list[str]:
    """Return the names of this user's running rigs."""
    return sorted(path.name[len(_RIG) : -len(_SOCKET)] for path in runtime_dir().glob(f"{_RIG}*{_SOCKET}"))


def rig_cameras(rig: str) -> dict[str, dict[str, Any]]:
    """Return camera name, prefixed with the rig's name → LeRobot camera options. Empty if the rig has ended.

    Only the rig's scene file is read, since a connection would restart a rig that was killed.
    """
    try:
        names = [camera.name for camera in told_scene(rig).cameras]
    except YamError as error:
        logger.debug("rig %s: %s", rig, error)
        return {}
    return {f"{rig}: {name}": {"type": VIRTUAL, "camera": name, "rig": rig, **_PICTURES} for name in names}


class LiveCamera:
    """Reader thread of one camera.

    Args:
        name: name of the camera in messages.
        options: camera options as in a run config.
        arms: arms of the run config.

    Attributes:
        picture: newest picture (height, width, 3), uint8 RGB; None before the first picture.
        trouble: error that ended the reading; empty if there was none.
    """

    def __init__(self, name: str, options: Mapping[str, Any], arms: Sequence[ArmConfig]):
        self.picture: np.ndarray | None = None
        self.trouble = ""
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(name, options, arms), name="yam-view-camera")
        self._thread.start()

    def _run(self, name: str, options: Mapping[str, Any], arms: Sequence[ArmConfig]) -> None:
        from lerobot_robot_yam.face.devices.images import open_camera  # imported late: loading LeRobot takes seconds

        try:
            camera = open_camera(name, options, arms)
        except YamError as error:
            self.trouble = str(error)
            return
        try:
            while not self._ending.is_set():
                self.picture = camera.async_read(timeout_ms=_WAIT_MS)
        except Exception as error:  # a camera driver may raise any error
            self.trouble = f"camera {name}: {error}"
        finally:
            camera.disconnect()

    def begin_close(self) -> None:
        """Signal the thread to end, without waiting for it."""
        self._ending.set()

    def close(self) -> None:
        """Disconnect the camera and wait for the thread to end. Idempotent."""
        self.begin_close()
        self._thread.join()


def overlaid(live: np.ndarray, recorded: np.ndarray, alpha: float) -> np.ndarray:
    """Return the live picture (height, width, 3) blended with the recorded picture, whose weight is `alpha`, 0 … 1."""
    height, width = live.shape[:2]
    fitted = cv2.resize(recorded, (width, height), interpolation=cv2.INTER_AREA)
    return cv2.addWeighted(live, 1.0 - alpha, fitted, alpha, 0.0)


class SceneMatch:
    """Menus to choose the live and the recorded camera, a blend slider, and the blended picture.

    Args:
        gui: the server's gui; the controls are added to its open container.
        recorded: cameras of the data set.
        cameras: name → camera options from a run config.
        arms: arms of the run config.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        recorded: Sequence[str],
        cameras: Mapping[str, Mapping[str, Any]],
        arms: Sequence[ArmConfig],
    ):
        self._cameras, self._arms = dict(cameras), arms
        self._rigs: dict[str, dict[str, dict[str, Any]]] = {}  # rig → camera → options
        self._live_choice = gui.add_dropdown("live camera", (_NONE, *cameras))
        self._recorded = gui.add_dropdown("over it", tuple(recorded) or (_NONE,))
        self._alpha = gui.add_slider("share of the recorded", 0.0, 1.0, 0.05, 0.5)
        self._said = gui.add_html("")
        self._image = gui.add_image(np.zeros((2, 2, 3), np.uint8), format="jpeg", visible=False)
        self._live: LiveCamera | None = None
        self._opened = _NONE
        self._ended: list[LiveCamera] = []
        self._looked_s = self._shown_s = -_LOOK_S

    def update(self, now_s: float, pictures: Mapping[str, np.ndarray | str]) -> None:
        """Show the newest live picture. `pictures`: camera → recorded picture at the playhead, or its error message."""
        if now_s - self._looked_s >= _LOOK_S:
            self._looked_s = now_s
            self._look()
        if self._live_choice.value != self._opened:
            self._open(self._live_choice.value)
        if self._live is None or now_s - self._shown_s < _SHOWN_S:
            return
        self._shown_s = now_s
        live, recorded = self._live.picture, pictures.get(self._recorded.value)
        said = self._live.trouble or (recorded if isinstance(recorded, str) else "")
        if live is None and not said:
            said = "opening the camera"
        put(self._said, content=f"<div style='padding:0 0.8em'>{html.escape(said)}</div>")
        if live is not None:
            shown = overlaid(live, recorded, self._alpha.value) if isinstance(recorded, np.ndarray) else live
            self._image.image = shown
        put(self._image, visible=live is not None)

    def _look(self) -> None:
        running = running_rigs()
        if running == list(self._rigs):
            return
        self._rigs = {rig: self._rigs.get(rig) or rig_cameras(rig) for rig in running}
        chosen, options = self._live_choice.value, (_NONE, *self._options())
        put(self._live_choice, options=options, value=chosen if chosen in options else _NONE)

    def _options(self) -> dict[str, Mapping[str, Any]]:
        return self._cameras | {name: options for rig in self._rigs.values() for name, options in rig.items()}

    def _open(self, name: str) -> None:
        if self._live is not None:
            self._live.begin_close()
            self._ended.append(self._live)
        self._opened, self._live = name, None
        put(self._image, visible=False)
        put(self._said, content="")
        options = self._options().get(name)
        if options is not None:
            self._live = LiveCamera(name, options, self._arms)

    def close(self) -> None:
        """Disconnect all cameras opened here. Idempotent."""
        self._open(_NONE)
        for camera in self._ended:
            camera.close()
        self._ended.clear()
