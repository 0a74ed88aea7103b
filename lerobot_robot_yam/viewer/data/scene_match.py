"""Lays a picture of a data set over what a camera sees now, so that a scene can be put back as it was."""

import html
from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
import viser

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.viewer.data.live_camera import LiveCamera, rig_cameras, running_rigs
from lerobot_robot_yam.viewer.serving.handles import put

_NONE = "none"
_LOOK_S = 2.0  # for rigs
_SHOWN_S = 0.1


def overlaid(live: np.ndarray, recorded: np.ndarray, alpha: float) -> np.ndarray:
    """The live picture (height, width, 3) with a share `alpha` of the recorded one, which takes its size."""
    height, width = live.shape[:2]
    fitted = cv2.resize(recorded, (width, height), interpolation=cv2.INTER_AREA)
    return cv2.addWeighted(live, 1.0 - alpha, fitted, alpha, 0.0)


class SceneMatch:
    """A choice of cameras, a slider, and the picture.

    Args:
        gui: of the server, inside the container that it is to be in.
        recorded: cameras of the data set.
        cameras: options of a run config's cameras, by name.
        arms: of that config.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        recorded: Sequence[str],
        cameras: Mapping[str, Mapping[str, Any]],
        arms: Sequence[ArmConfig],
    ):
        self._cameras, self._arms = dict(cameras), arms
        self._rigs: dict[str, dict[str, dict[str, Any]]] = {}  # their cameras' options, by rig
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
        """Show the newest live picture; `pictures`: of the data set's frame that is looked at, by camera."""
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
        """Let go of the cameras. Idempotent."""
        self._open(_NONE)
        for camera in self._ended:
            camera.close()
        self._ended.clear()
