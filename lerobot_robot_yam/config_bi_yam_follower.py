"""LeRobot config of two follower arms (`--robot.type=bi_yam_follower`)."""

from collections.abc import Mapping
from dataclasses import dataclass

from lerobot.cameras.configs import CameraConfig
from lerobot.robots.config import RobotConfig

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.devices.follower_options import FollowerArmConfig, FollowerOptions
from lerobot_robot_yam.face.registration import register_as


@register_as(RobotConfig, "bi_yam_follower", spare="bi_i2rt_yam_follower")
@dataclass(kw_only=True)
class BiYamFollowerConfig(RobotConfig, FollowerOptions):
    """Two follower arms. `cameras` keep their names, those of an arm get `left_` or `right_` in front."""

    left_arm_config: FollowerArmConfig
    right_arm_config: FollowerArmConfig

    def arms(self) -> Mapping[str, FollowerArmConfig]:
        """The sides by prefix, in canonical order."""
        return {"left_": self.left_arm_config, "right_": self.right_arm_config}

    def all_cameras(self) -> dict[str, CameraConfig]:
        """Every camera under the name that its images have in observations.

        Raises:
            ConfigError: two cameras have the same name, or one lacks its size or rate.
        """
        cameras = dict(self.cameras)
        for prefix, arm in self.arms().items():
            for name, camera in arm.cameras.items():
                if f"{prefix}{name}" in cameras:
                    raise ConfigError(f"two cameras are called {prefix}{name}; rename one")
                cameras[f"{prefix}{name}"] = camera
        for name, camera in cameras.items():
            if None in (camera.width, camera.height, camera.fps):
                raise ConfigError(f"camera {name}: give width, height and fps")
        return cameras


@register_as(RobotConfig, "bi_i2rt_yam_follower")
class BiI2rtYamFollowerConfig(BiYamFollowerConfig):
    """The same by a name that no other plugin claims."""
