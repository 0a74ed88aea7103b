"""The cameras that a rig may use, as LeRobot's configs name them. None is opened."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lerobot_robot_yam.commands.lib.new_rig.found_arms import Place
from lerobot_robot_yam.doctor.check_cameras import Camera, read_cameras
from lerobot_robot_yam.rig.client.rig_control import RigControl

_PIXELS = {"width": 640, "height": 480, "fps": 30}
_BY_PATH = "dev/v4l/by-path"  # links that stay: /dev/videoN follows the order of discovery


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
    """Cameras of the virtual rig; else of the computer. Raises RigError: the rig cannot be reached."""
    if place.rig is None:
        return [_real(camera, place.root or Path("/")) for camera in read_cameras(place.sysfs)]
    with RigControl(place.rig, hold=False) as rig:
        names = rig.scene()["cameras"]
    size = {"width": 320, "height": 240, "fps": 30}
    return [FoundCamera(f"{name} of the rig", {"type": "yam_sim", "camera": name, **size}, name) for name in names]


def _real(camera: Camera, root: Path) -> FoundCamera:
    if camera.realsense:
        serial = (camera.usb and camera.usb.serial) or "000000000000"
        return FoundCamera(camera.label, {"type": "intelrealsense", "serial_number_or_name": serial, **_PIXELS})
    links = sorted((root / _BY_PATH).glob("*-video-index0"))
    stable = [f"/{_BY_PATH}/{link.name}" for link in links if link.resolve().name in camera.nodes]
    path = (stable or [f"/dev/{node}" for node in camera.nodes])[0]
    return FoundCamera(camera.label, {"type": "opencv", "index_or_path": path, **_PIXELS})
