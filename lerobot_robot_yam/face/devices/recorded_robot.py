"""Common part of all robots: cameras, the log of a recording's episodes, and the desk that a page reads."""

import contextlib
import logging
from collections.abc import Iterable, Iterator

from lerobot.cameras.camera import Camera
from lerobot.cameras.configs import CameraConfig
from lerobot.cameras.utils import make_cameras_from_configs
from lerobot.robots.robot import Robot

from lerobot_robot_yam.arm.config import ChannelConfig
from lerobot_robot_yam.face.devices.images import ImageReader, beside_arms
from lerobot_robot_yam.face.recorder.episode_log import EpisodeLog
from lerobot_robot_yam.face.session_desk import SessionDesk
from lerobot_robot_yam.session.uncopyable import Uncopied

logger = logging.getLogger(__name__)


class RecordedRobot(Uncopied, Robot):
    """LeRobot robot with cameras."""

    cameras: dict[str, Camera]

    def _make_cameras(self, cameras: dict[str, CameraConfig], parts: Iterable[ChannelConfig]) -> None:
        """Create the cameras, by the names of their images. parts: arms and base, whose rig virtual cameras show."""
        parts = list(parts)
        self._camera_configs = {name: beside_arms(camera, parts) for name, camera in cameras.items()}
        self.cameras = make_cameras_from_configs(self._camera_configs)
        self._images = ImageReader(self.cameras, self._camera_configs)
        self._episodes, self._desk = EpisodeLog(), SessionDesk()

    def _image_features(self) -> dict[str, tuple[int, int, int]]:
        features = {}
        for name, config in self._camera_configs.items():
            height, width = config.height, config.width
            assert height is not None and width is not None  # LeRobot's and our configs check it
            if getattr(config, "use_rgb", True):
                features[name] = (height, width, 3)
            if getattr(config, "use_depth", False):
                features[f"{name}_depth"] = (height, width, 1)
        return features

    @contextlib.contextmanager
    def _open(self) -> Iterator[None]:
        """Begin log and desk and open the cameras; an error in the block ends and closes them again."""
        self._episodes.begin()
        self._desk.begin()
        try:
            for camera in self.cameras.values():
                camera.connect()
            yield
        except BaseException:
            self._close()
            raise

    def _close(self) -> None:
        """Close the cameras, end log and desk. Idempotent; a camera's error is only logged."""
        for name, camera in self.cameras.items():
            try:
                if camera.is_connected:
                    camera.disconnect()
            except Exception as error:
                logger.warning("camera %s did not close: %s", name, error)
        self._episodes.end()
        self._desk.end()
