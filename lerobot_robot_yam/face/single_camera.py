"""One camera of a run config, opened by itself: LeRobot's class for its type, in the rig of the config's arms."""

import importlib
from collections.abc import Iterable, Mapping
from typing import Any

import draccus
from lerobot.cameras.camera import Camera
from lerobot.cameras.configs import CameraConfig
from lerobot.cameras.utils import make_cameras_from_configs

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.errors import CameraError, ConfigError
from lerobot_robot_yam.face.devices.images import beside_arms

_REGISTER = ("lerobot.cameras.opencv", "lerobot.cameras.realsense")  # as LeRobot's commands import them


def open_camera(name: str, options: Mapping[str, Any], arms: Iterable[ArmConfig] = ()) -> Camera:
    """A camera that is connected; whoever opens it disconnects it.

    Args:
        name: what messages call it.
        options: as in a run config, with its type.
        arms: of that config; a camera `yam_sim` looks at their rig.

    Raises:
        ConfigError: LeRobot does not take these options.
        CameraError: it cannot be opened.
    """
    for module in _REGISTER:
        importlib.import_module(module)
    try:
        config = beside_arms(draccus.decode(CameraConfig, dict(options)), arms)
    except Exception as error:  # draccus raises anything
        raise ConfigError(f"camera {name}: {error}") from error
    try:
        (camera,) = make_cameras_from_configs({name: config}).values()
        camera.connect()
    except Exception as error:  # so do drivers of cameras
        raise CameraError(f"camera {name} cannot be opened: {error}; does another program use it?") from error
    return camera
