"""Which virtual rig a robot's rendered cameras look at: that of its arms."""

import dataclasses
from collections.abc import Iterable
from typing import Any

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.rig.scene.scene import Options
from lerobot_robot_yam.system.runtime_files import rig_name

_SCENE_OPTIONS = {field.name for field in dataclasses.fields(Options)}


def beside_arms(camera: Any, arms: Iterable[ArmConfig]) -> Any:
    """A camera's config in the rig of a robot's virtual arms, unless it names another; it may be the first to start it.

    Args:
        camera: of any type; other cameras than the rig's stay as they are.
        arms: those of the robot.
    """
    said = next((arm.can_options for arm in arms if arm.interface == "yam_sim"), None)
    if said is None or camera.type != "yam_sim" or camera.rig != "auto":
        return camera
    options = {key: value for key, value in said.items() if key in _SCENE_OPTIONS}
    return dataclasses.replace(
        camera,
        rig=rig_name(said.get("rig"))[0],
        scene=camera.scene or said.get("scene"),
        rig_options=camera.rig_options or options,
    )
