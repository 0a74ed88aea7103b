"""Client of a virtual rig's rendered camera, for any program.

with RigCamera("top", 320, 240, 30) as camera:
    frame, stamp_s = camera.latest()
"""

import contextlib
import json
import select
import socket
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lerobot_robot_yam.errors import RigError, StaleStateError
from lerobot_robot_yam.rig.client import launch
from lerobot_robot_yam.system.runtime_files import slug
from lerobot_robot_yam.system.shared_block import SharedBlock

Settings = tuple[str, int, int, int]
"""Camera, width and height in pixels, frames per second."""

MAX_WIDTH, MAX_HEIGHT = 1280, 960
MAX_FPS = 60
_POLL_S = 0.002
_TOO_BUSY = (
    "this machine is too busy: end other programs, or have the rig draw less: fewer cameras, or "
    "`can_options: {pictures: plain}` in the config of an arm"
)
_MAX_AGE_S = 0.5


def frame_dtype(width: int, height: int) -> np.dtype:
    """Return the dtype of one frame: monotonic and simulated time of its state, a counter, the RGB image."""
    return np.dtype([("stamp_s", "f8"), ("sim_s", "f8"), ("number", "u8"), ("rgb", np.uint8, (height, width, 3))])


def frame_path(rig: str, camera: str, width: int, height: int, fps: int) -> Path:
    """Return the file of the block with the latest frame; cameras with equal settings share the block."""
    return launch.rig_path(rig, f"camera-{slug(camera)}-{width}x{height}-{fps}")


class _Frame(NamedTuple):
    """A frame: number, monotonic time of its state in s, and image (height, width, 3) uint8 RGB."""

    number: int
    stamp_s: float
    rgb: np.ndarray


class RigCamera:
    """Client of one camera. While the client is connected, the rig stays alive and renders the camera.

    Args:
        camera: name in the scene.
        width, height: pixels.
        fps: frames per second.
        rig: name of the rig, see `runtime_files.rig_name`.
        scene: scene to use if `connect` starts the rig.
        options: scene options to use if `connect` starts the rig.
    """

    def __init__(
        self,
        camera: str,
        width: int = 320,
        height: int = 240,
        fps: int = 30,
        rig: str | None = None,
        scene: str | None = None,
        options: Mapping[str, Any] | None = None,
    ):
        self.camera, self.width, self.height, self.fps = camera, width, height, fps
        self._rig, self._scene, self._options = rig, scene, options
        self._socket: socket.socket | None = None
        self._block: SharedBlock | None = None
        self._seen = 0
        self._newest: tuple[int, _Frame | None] = (-1, None)  # sequence number of the block, and its frame
        self._heard: dict[str, Any] = {}  # last message from the rig about this camera

    @property
    def is_connected(self) -> bool:
        return self._block is not None

    def connect(self, timeout_s: float = 30.0) -> None:
        """Connect to the rig, starting it if necessary, and wait for the first frame. Does nothing if connected.

        Raises:
            ConfigError: the scene has no such camera, or the camera does not support these settings.
            RigError: there is no rig or no OpenGL, or no frame arrived within timeout_s.
        """
        if self.is_connected:
            return
        deadline = time.monotonic() + timeout_s
        hello: dict[str, Any] = {"kind": "camera", "camera": self.camera}
        hello |= {"width": self.width, "height": self.height, "fps": self.fps}
        self._socket, name, _ = launch.connect_or_start(self._rig, hello, self._scene, self._options)
        try:
            if not select.select([self._socket], [], [], max(0.0, deadline - time.monotonic()))[0]:
                raise RigError(f"camera {self.camera}: the renderer did not start in time; {_TOO_BUSY}")
            self._hear()
            path = frame_path(name, self.camera, self.width, self.height, self.fps)
            self._block = SharedBlock(path, frame_dtype(self.width, self.height), create=False)
            self.wait_new(max(0.1, deadline - time.monotonic()))
        except BaseException:
            self.close()
            raise

    def _hear(self) -> None:
        """Read one packet from the rig, if any. Once a packet has contained an error, each call raises that error."""
        assert self._socket is not None
        launch.checked(self._heard)
        try:
            packet = self._socket.recv(launch.MAX_PACKET, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return
        except ConnectionResetError:
            packet = b""
        if not packet:
            raise RigError(f"camera {self.camera}: the rig has ended; connect again to start one")
        self._heard = json.loads(packet)
        launch.checked(self._heard)

    def latest(self, max_age_s: float = _MAX_AGE_S) -> tuple[np.ndarray, float]:
        """Return the latest frame, without waiting.

        Returns:
            Image (height, width, 3) uint8 RGB, the same array as before if there is no newer frame, and the monotonic
            time of the frame's state in s.

        Raises:
            StaleStateError: the frame is older than max_age_s.
            RigError: the camera is not connected, or the rig or its renderer has ended.
        """
        record = self._read(self._connected())
        age = float("inf") if record is None else time.monotonic() - record.stamp_s
        if record is None or age > max_age_s:
            self._hear()
            raise StaleStateError(
                f"camera {self.camera}: newest frame is {age * 1e3:.0f} ms old, more than {max_age_s * 1e3:.0f} ms; "
                + _TOO_BUSY
            )
        self._seen = record.number
        return record.rgb, record.stamp_s

    def wait_new(self, timeout_s: float = 1.0) -> tuple[np.ndarray, float]:
        """Return the next frame that no call has returned yet, in the format of `latest`.

        Raises:
            StaleStateError: no frame arrived within timeout_s; frames from before a renderer stall do not count.
            RigError: the camera is not connected, or the rig or its renderer has ended.
        """
        block = self._connected()
        deadline = time.monotonic() + timeout_s
        max_age_s = _MAX_AGE_S + 1.0 / self.fps
        sequence = None
        while True:
            if block.sequence() != sequence:
                sequence = block.sequence()
                record = self._read(block)
                if record is not None and record.number > self._seen:
                    self._seen = record.number
                    if time.monotonic() - record.stamp_s < max_age_s:
                        return record.rgb, record.stamp_s
            if time.monotonic() > deadline:
                self._hear()
                raise StaleStateError(
                    f"camera {self.camera}: no new frame within {timeout_s * 1e3:.0f} ms; {_TOO_BUSY}"
                )
            time.sleep(_POLL_S)

    def _read(self, block: SharedBlock) -> _Frame | None:
        sequence, (before, frame) = block.sequence(), self._newest
        if sequence == before:  # each frame is copied and checked only once
            return frame
        try:
            record = block.read()
            frame = None if record is None else _Frame(int(record["number"]), float(record["stamp_s"]), record["rgb"])
            self._newest = sequence + sequence % 2, frame  # odd: `read` waited for the frame being written
            return frame
        except StaleStateError as error:
            self._hear()
            raise StaleStateError(f"camera {self.camera}: its renderer stopped in the middle of a picture") from error

    def _connected(self) -> SharedBlock:
        if self._block is None:
            raise RigError(f"camera {self.camera} is not connected; call connect() first")
        return self._block

    def close(self) -> None:
        """Disconnect from the rig. Idempotent."""
        block, self._block = self._block, None
        if block is not None:
            block.close()
        sock, self._socket = self._socket, None
        if sock is not None:
            with contextlib.suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)  # also ends the socket's copy in a forked child
            sock.close()
        self._seen, self._heard, self._newest = 0, {}, (-1, None)

    def __enter__(self) -> "RigCamera":
        self.connect()
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
