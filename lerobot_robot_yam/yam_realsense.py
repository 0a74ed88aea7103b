"""RealSense as a LeRobot camera: by librealsense or as UVC, found by serial number, with automatic reconnection."""

import time
from typing import Any

import cv2
import numpy as np
from lerobot.cameras.camera import Camera
from lerobot.cameras.configs import ColorMode, Cv2Rotation
from lerobot.cameras.utils import get_cv2_rotation
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected

from lerobot_robot_yam.cameras.camera_feed import CameraFeed
from lerobot_robot_yam.cameras.opening import open_camera
from lerobot_robot_yam.cameras.picture_source import Picture, Wanted
from lerobot_robot_yam.cameras.video_devices import video_devices
from lerobot_robot_yam.config_yam_realsense import YamRealsenseCameraConfig
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.paths import user_path

_READ_S = 10.0  # timeout of read(), s, as in LeRobot's own class
_SIDEWAYS = (Cv2Rotation.ROTATE_90, Cv2Rotation.ROTATE_270)


class YamRealsenseCamera(Camera):
    """Camera with images (height, width, 3) uint8 and depth (height, width, 1) uint16 in mm, as configured."""

    def __init__(self, config: YamRealsenseCameraConfig):
        super().__init__(config)
        self.config = config
        self._rotation = get_cv2_rotation(config.rotation)
        width, height = config.width, config.height
        if config.rotation in _SIDEWAYS:
            width, height = height, width
        self._wanted = Wanted(
            serial=config.serial_number_or_name,
            width=width,
            height=height,
            fps=config.fps,
            colour=config.use_rgb,
            depth=config.use_depth,
            exposure=config.exposure,
            gain=config.gain,
            white_balance=config.white_balance,
        )
        self._feed = CameraFeed(str(self), lambda: open_camera(self._wanted, user_path(config.root)), self._finished)
        self._seen = {"colour": 0, "depth": 0}  # numbers of the last images that async_read has returned

    def __str__(self) -> str:
        return f"YamRealsenseCamera({self.config.serial_number_or_name})"

    @property
    def is_connected(self) -> bool:
        return self._feed.running

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        """List the connected cameras, by the serial numbers of their USB devices."""
        return [{"name": d.model, "type": "yam_realsense", "id": d.serial} for d in video_devices() if d.serial]

    @check_if_already_connected
    def connect(self, warmup: bool = True) -> None:
        """Open the camera and wait for the first image.

        Args:
            warmup: whether to wait until exposure and white balance have settled: `warmup_s` in the config.

        Raises:
            CameraError: the camera is missing or in use, or access is denied; the message says what to do.
            ConfigError: the camera does not support the configured values; the message lists supported ones.
        """
        self._feed.start()
        self._seen = dict.fromkeys(self._seen, 0)
        if warmup:
            time.sleep(self.config.warmup_s)
        picture = self._feed.latest(float("inf"))
        image = picture.colour if picture.colour is not None else picture.depth
        assert image is not None, "the config asks for one of the two"
        self.height, self.width = image.shape[:2]

    @check_if_not_connected
    def read(self) -> np.ndarray:
        """Wait for an image taken after this call. Raises StaleStateError (a TimeoutError): none within 10 s."""
        return self._of(self._feed.wait_new(self._feed.number, _READ_S)[0], "colour")

    @check_if_not_connected
    def read_depth(self) -> np.ndarray:
        """Wait for a depth image taken after this call; otherwise as `read`."""
        return self._of(self._feed.wait_new(self._feed.number, _READ_S)[0], "depth")

    @check_if_not_connected
    def async_read(self, timeout_ms: float = 200) -> np.ndarray:
        """Return the newest image; if it was already returned, wait for the next one.

        Raises:
            StaleStateError (a TimeoutError): no new image within timeout_ms.
        """
        return self._unseen("colour", timeout_ms)

    @check_if_not_connected
    def async_read_depth(self, timeout_ms: float = 200) -> np.ndarray:
        """Return a depth image; otherwise as `async_read`."""
        return self._unseen("depth", timeout_ms)

    @check_if_not_connected
    def read_latest(self, max_age_ms: int = 500) -> np.ndarray:
        """Return the newest image without waiting.

        Raises:
            StaleStateError (a TimeoutError): the image is older than max_age_ms; the message states the reason.
        """
        return self._of(self._feed.latest(max_age_ms / 1e3), "colour")

    @check_if_not_connected
    def read_latest_depth(self, max_age_ms: int = 500) -> np.ndarray:
        """Return a depth image; otherwise as `read_latest`."""
        return self._of(self._feed.latest(max_age_ms / 1e3), "depth")

    def disconnect(self) -> None:
        """Release the camera. Idempotent."""
        self._feed.stop()

    def _unseen(self, kind: str, timeout_ms: float) -> np.ndarray:
        picture, self._seen[kind] = self._feed.wait_new(self._seen[kind], timeout_ms / 1e3)
        return self._of(picture, kind)

    def _of(self, picture: Picture, kind: str) -> np.ndarray:
        image = getattr(picture, kind)
        if image is None:
            switch = "use_rgb" if kind == "colour" else "use_depth"
            raise ConfigError(f"{self} gives no {kind}: set {switch} to true")
        return image

    def _finished(self, picture: Picture) -> Picture:
        colour, depth = picture.colour, picture.depth
        if colour is not None and self.config.color_mode is ColorMode.BGR:
            colour = cv2.cvtColor(colour, cv2.COLOR_RGB2BGR)
        if self._rotation is not None:
            colour = None if colour is None else cv2.rotate(colour, self._rotation)
            depth = None if depth is None else cv2.rotate(depth, self._rotation)[..., np.newaxis]
        return Picture(picture.stamp_s, colour, depth)
