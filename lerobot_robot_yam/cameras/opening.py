"""Finding a camera by its serial number, and opening it: with librealsense where that sees it, else as UVC."""

from pathlib import Path
from typing import Any

from lerobot_robot_yam.cameras.picture_source import PictureSource, Wanted
from lerobot_robot_yam.cameras.video_devices import ROOT, VideoDevice, listed, video_devices, with_serial
from lerobot_robot_yam.errors import CameraError


def open_camera(wanted: Wanted, root: Path = ROOT) -> PictureSource:
    """Open a camera.

    Args:
        wanted: which, and how.
        root: of the computer's files. librealsense looks at this very computer, so that it is asked for "/" only.

    Raises:
        CameraError: it is not there, there are two of it, no rights, in use; says what to do.
        ConfigError: it does not offer what is wanted; says what it offers.
    """
    device, seen = find_camera(wanted.serial, root)
    if device is not None:
        from lerobot_robot_yam.cameras.realsense_source import RealSenseSource

        return RealSenseSource(device, wanted, seen)
    assert seen is not None
    from lerobot_robot_yam.cameras.uvc_source import UvcSource

    return UvcSource(seen, wanted)


def find_camera(serial: str, root: Path = ROOT) -> tuple[Any | None, VideoDevice | None]:
    """A camera by serial number or model: librealsense's device, and what sysfs shows; not both are None.

    Raises:
        CameraError: there is none, which says what there is; or there are two.
    """
    from lerobot_robot_yam.cameras.realsense_source import info, library, plugged_in, serials

    devices = video_devices(root)
    found = []
    for device in plugged_in() if root == ROOT else []:
        if serial in (*serials(device), info(device, "name")):
            found.append(device)
    if len(found) > 1:
        raise CameraError(f"{len(found)} RealSense cameras are {serial}: give the serial number of one")
    if found:
        return found[0], next((d for d in devices if d.serial and d.serial in serials(found[0])), None)
    seen = with_serial(devices, serial)
    if seen is not None:
        return None, seen
    remedy = "plug it in, or correct the serial number (`yam-cameras list`)"
    if any(device.realsense for device in devices):
        try:
            library()
        except CameraError as error:  # without it, the number on a RealSense's label is not known
            remedy += f". The number on a RealSense's label is known to librealsense only, and {error}"
    raise CameraError(f"there is no camera {serial}; there are: {listed(devices)}; {remedy}")
