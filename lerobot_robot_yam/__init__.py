"""I2RT YAM arms, real or virtual, for LeRobot.

Importing this package is cheap: types are registered when LeRobot is imported, and public names load on first use.
"""

import importlib
from typing import TYPE_CHECKING, Any

from lerobot_robot_yam.face import registration

if TYPE_CHECKING:
    from lerobot_robot_yam.arm.kinematics import YamKinematics as YamKinematics
    from lerobot_robot_yam.config_yam_camera import YamSimCameraConfig as YamSimCameraConfig
    from lerobot_robot_yam.config_yam_follower import BiYamFollowerConfig as BiYamFollowerConfig
    from lerobot_robot_yam.config_yam_follower import YamFollowerConfig as YamFollowerConfig
    from lerobot_robot_yam.config_yam_mobile import YamBaseRobotConfig as YamBaseRobotConfig
    from lerobot_robot_yam.config_yam_mobile import YamMobileConfig as YamMobileConfig
    from lerobot_robot_yam.config_yam_realsense import YamRealsenseCameraConfig as YamRealsenseCameraConfig
    from lerobot_robot_yam.session.yam_arm import YamArm as YamArm
    from lerobot_robot_yam.waldo.client.async_client import AsyncRobotClient as AsyncRobotClient
    from lerobot_robot_yam.waldo.client.sync_client import RobotClient as RobotClient
    from lerobot_robot_yam.yam_camera import YamSimCamera as YamSimCamera
    from lerobot_robot_yam.yam_follower import BiYamFollower as BiYamFollower
    from lerobot_robot_yam.yam_follower import YamFollower as YamFollower
    from lerobot_robot_yam.yam_mobile import YamBaseRobot as YamBaseRobot
    from lerobot_robot_yam.yam_mobile import YamMobile as YamMobile
    from lerobot_robot_yam.yam_realsense import YamRealsenseCamera as YamRealsenseCamera

_MODULES = {
    "YamArm": "session.yam_arm",
    "YamKinematics": "arm.kinematics",
    "YamFollower": "yam_follower",
    "YamFollowerConfig": "config_yam_follower",
    "BiYamFollower": "yam_follower",
    "BiYamFollowerConfig": "config_yam_follower",
    "YamBaseRobot": "yam_mobile",
    "YamBaseRobotConfig": "config_yam_mobile",
    "YamMobile": "yam_mobile",
    "YamMobileConfig": "config_yam_mobile",
    "YamSimCamera": "yam_camera",
    "YamSimCameraConfig": "config_yam_camera",
    "YamRealsenseCamera": "yam_realsense",
    "YamRealsenseCameraConfig": "config_yam_realsense",
}
__all__ = list(_MODULES)
# Names omitted from `import *`, since they require waldoctl.
_MODULES |= {"RobotClient": "waldo.client.sync_client", "AsyncRobotClient": "waldo.client.async_client"}

registration.register()


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; it has {', '.join(_MODULES)}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
