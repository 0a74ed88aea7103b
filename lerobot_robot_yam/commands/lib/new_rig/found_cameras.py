"""The cameras that a rig may use, as LeRobot's configs name them. None is opened."""

from dataclasses import dataclass
from typing import Any

from lerobot_robot_yam.cameras.opening import config_of, plugged_cameras
from lerobot_robot_yam.cameras.video_devices import ROOT
from lerobot_robot_yam.commands.lib.new_rig.found_arms import Place
from lerobot_robot_yam.rig.client.rig_control import RigControl

_PIXELS = {"width": 640, "height": 480, "fps": 30}


@dataclass(frozen=True)
class FoundCamera:
    """One camera.

    Attributes:
        label: for the person who names it.
        options: LeRobot's config of it.
        name: a name that suits it, empty without one.
    """

    label: str
    options: dict[str, Any]
    name: str = ""


def find_cameras(place: Place) -> list[FoundCamera]:
    """Cameras of the virtual rig; else of the computer.

    Raises:
        RigError: the rig cannot be reached.
        CameraError: nothing tells a camera from another.
    """
    if place.rig is None:
        root = place.root or ROOT
        return [FoundCamera(str(one), config_of(one, root) | _PIXELS) for one in plugged_cameras(root)]
    with RigControl(place.rig, hold=False) as rig:
        names = rig.scene()["cameras"]
    size = {"width": 320, "height": 240, "fps": 30}
    return [FoundCamera(f"{name} of the rig", {"type": "yam_sim", "camera": name, **size}, name) for name in names]
