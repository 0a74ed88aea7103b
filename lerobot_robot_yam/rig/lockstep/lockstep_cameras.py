"""Rendered cameras of a rig in lock-step: each image shows the instant of its request."""

import select
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_robot_yam.errors import RigError
from lerobot_robot_yam.rig.client.launch import checked, rig_path, tell_scene
from lerobot_robot_yam.rig.client.rendered_camera import frame_dtype
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.rig.server.child_processes import CameraService
from lerobot_robot_yam.system.shared_block import SharedBlock

_TIMEOUT_S = 60.0  # maximum wait for the renderer, which also builds its world, in wall-clock time

_renderers: dict[str, "LockstepRenderer"] = {}


def _renderer_of(rig: LockstepRig) -> "LockstepRenderer":
    if rig.name not in _renderers:
        _renderers[rig.name] = LockstepRenderer(rig)
        rig.at_close.append(lambda: _renderers.pop(rig.name).close())
    return _renderers[rig.name]


class LockstepRenderer:
    """All cameras of one rig, rendered together by one process, which ends with the rig."""

    def __init__(self, rig: LockstepRig):
        self._rig = rig
        names = [camera.name for camera in rig.device.scene.cameras]
        self._service = CameraService(rig.name, names, on_demand=True)
        tell_scene(rig.name, rig.scene_name, rig.options)
        self._drawn: tuple[int, int] | None = None  # number of restarts and of physics steps at the latest images
        self._answers: dict[Any, dict[str, Any]] = {}

    def open(self, client: "LockstepCamera", hello: dict[str, Any]) -> Path:
        """Start rendering a camera; return the path of the block with its latest frame.

        Raises:
            ConfigError: the camera is unknown, or its settings are impossible.
            RigError: OpenGL is not available.
        """
        self._rig.show()  # the renderer opens the world block when it starts
        path = Path(self._service.open(client, hello)["block"])
        self._wait(lambda: client in self._answers)
        checked(self._answers.pop(client))
        self._drawn = None
        return path

    def drop(self, client: "LockstepCamera") -> None:
        self._service.drop(client)

    def look(self) -> None:
        """Render the current state of the world, unless the images already show it."""
        rig = self._rig
        present = rig.restarts, rig.device.world.steps
        if present != self._drawn:
            rig.show()
            self._service.draw(anew=self._drawn is None or self._drawn[0] != present[0])
            self._wait(lambda: self._service.drawn)
            self._drawn = present

    def _wait(self, done: Callable[[], bool]) -> None:
        while True:
            for client, answer in self._service.poll():
                self._answers[client] = answer
            if done():
                return
            fileno = self._service.fileno()
            if fileno is None or not select.select([fileno], [], [], _TIMEOUT_S)[0]:
                raise RigError(f"rig {self._rig.name}: its renderer has ended or hangs; are OpenGL and EGL installed?")

    def close(self) -> None:
        """End the renderer. Idempotent."""
        self._service.close()
        rig_path(self._rig.name, "scene").unlink(missing_ok=True)


class LockstepCamera:
    """One camera with the methods of `rendered_camera.RigCamera`, whose images are never stale.

    camera: name in the scene. width, height: pixels. fps: no effect, because each request renders an image.
    """

    def __init__(self, rig: LockstepRig, camera: str, width: int, height: int, fps: int):
        self._rig = rig
        self._hello = {"camera": camera, "width": width, "height": height, "fps": fps}
        self._dtype = frame_dtype(width, height)
        self._block: SharedBlock | None = None

    @property
    def is_connected(self) -> bool:
        return self._block is not None

    def connect(self) -> None:
        """Start rendering this camera's images. Does nothing if already connected.

        Raises:
            ConfigError: the scene has no such camera, or the camera does not support these settings.
            RigError: OpenGL is not available.
        """
        if self._block is None:
            self._block = SharedBlock(_renderer_of(self._rig).open(self, self._hello), self._dtype, create=False)

    def latest(self, max_age_s: float = 0.0) -> tuple[np.ndarray, float]:
        """Return an image of the current instant, (height, width, 3) uint8 RGB, and the rig's time in s.

        Raises:
            RigError: the camera is not connected, or the renderer has ended.
        """
        if self._block is None:
            raise RigError(f"camera {self._hello['camera']} is not connected; call connect() first")
        _renderer_of(self._rig).look()
        record = self._block.read()
        assert record is not None
        return record["rgb"], float(record["stamp_s"])

    def wait_new(self, timeout_s: float = 0.0) -> tuple[np.ndarray, float]:
        """Return `latest`, without waiting."""
        return self.latest()

    def close(self) -> None:
        """Stop rendering the camera. Idempotent."""
        block, self._block = self._block, None
        if block is not None:
            block.close()
            _renderer_of(self._rig).drop(self)
