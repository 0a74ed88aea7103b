"""Search for a camera by serial number. Cameras known to librealsense are opened by it, all others as UVC devices."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lerobot_robot_yam.cameras import v4l2
from lerobot_robot_yam.cameras.picture_source import PictureSource, Wanted
from lerobot_robot_yam.cameras.realsense_source import RealSenseSource, info, library, modes_of, plugged_in, serials
from lerobot_robot_yam.cameras.video_devices import ROOT, VideoDevice, model_of, video_devices
from lerobot_robot_yam.errors import CameraError
from lerobot_robot_yam.system.own_commands import as_root


@dataclass(frozen=True)
class Plugged:
    """Camera that is plugged in, as found in sysfs, by librealsense, or by both."""

    seen: VideoDevice | None
    device: Any | None = None

    def __str__(self) -> str:
        where = f" ({self.seen.place})" if self.seen else ""
        return f"{self.model} {self.serial or 'without serial number'}{where}"

    @property
    def model(self) -> str:
        """Model: "D405" for a RealSense, else the manufacturer's name of the camera."""
        return self.seen.model if self.seen else model_of(info(self.device, "name") or "camera")

    @property
    def serial(self) -> str | None:
        """Serial number on a RealSense's label if librealsense can read it, else that of the USB device."""
        label = serials(self.device)[0] if self.device is not None else None
        return label or (self.seen.serial if self.seen else None)

    def is_called(self, name: str) -> bool:
        """Return whether `name` is the camera's model or its serial number (on the label or of the USB device)."""
        names = {self.model, *([self.seen.serial] if self.seen else [])}
        if self.device is not None:
            names |= {*serials(self.device), info(self.device, "name")}
        return name in names

    def modes(self) -> list[str]:
        """List the camera's colour formats; empty if unknown. Raises CameraError: the camera cannot be opened."""
        if self.device is not None:
            sizes = modes_of(self.device, library().stream.color)
            return [f"{width}x{height} at {fps} fps" for width, height, fps in sizes]
        nodes = self.seen.nodes if self.seen else ()
        return [str(mode) for node in nodes for mode in v4l2.modes(node)]

    def open(self, wanted: Wanted) -> PictureSource:
        """Open the camera.

        Raises:
            CameraError: the camera is in use, or access is denied; the message contains the remedy.
            ConfigError: the camera does not support a wanted setting; the message lists the supported values.
        """
        if self.device is not None:
            return RealSenseSource(self.device, wanted, self.seen)
        from lerobot_robot_yam.cameras.uvc_source import UvcSource  # imports OpenCV, which is slow

        assert self.seen is not None
        return UvcSource(self.seen, wanted)


def plugged_cameras(root: Path = ROOT) -> list[Plugged]:
    """List all cameras that are plugged in.

    Args:
        root: file system root. librealsense always reports the cameras of this computer, so it is used only for "/".
    """
    seen = video_devices(root)
    found = []
    for device in plugged_in() if root == ROOT else []:
        beside = next((d for d in seen if d.serial and d.serial in serials(device)), None)
        found.append(Plugged(beside, device))
    known = [camera.seen for camera in found]
    return found + [Plugged(device) for device in seen if device not in known]


def find_camera(name: str, root: Path = ROOT) -> Plugged:
    """Find the camera with this serial number, or the only camera of this model.

    Raises:
        CameraError: no camera or several cameras match `name`; the message lists the cameras.
    """
    cameras = plugged_cameras(root)
    found = [camera for camera in cameras if camera.is_called(name)]
    if len(found) == 1:
        return found[0]
    if found and any(camera.model != name for camera in found):
        raise CameraError(
            f"{len(found)} cameras have the serial number {name}: {listed(found)}; unplug all but one, or use "
            "LeRobot's type opencv with a path of /dev/v4l/by-path"
        )
    if found:
        raise CameraError(f"there are {len(found)} of {name}: {listed(found)}; give the serial number of one")
    remedy = "plug it in, or correct the serial number (`yam-cameras list`)"
    if any(camera.seen and camera.seen.realsense and camera.device is None for camera in cameras) and root == ROOT:
        remedy += ". " + _why_no_label()
    raise CameraError(f"there is no camera {name}; there are: {listed(cameras)}; {remedy}")


def open_camera(wanted: Wanted, root: Path = ROOT) -> PictureSource:
    """Find a camera and open it. Raises CameraError, ConfigError: see `find_camera` and `Plugged.open`."""
    return find_camera(wanted.serial, root).open(wanted)


def config_of(camera: Plugged, root: Path = ROOT) -> dict[str, Any]:
    """Return config fields that identify a camera; a webcam without a unique serial number is identified by USB port.

    Raises:
        CameraError: nothing distinguishes the camera from another camera.
    """
    same = [other for other in plugged_cameras(root) if other.serial == camera.serial]
    if camera.serial and len(same) == 1:
        elsewhere = {} if root == ROOT else {"root": str(root)}
        return {"type": "yam_realsense", "serial_number_or_name": camera.serial, **elsewhere}
    paths = [link for link in camera.seen.links if link.parent.name == "by-path"] if camera.seen else []
    if not paths:
        raise CameraError(f"{camera}: nothing tells it from another camera; plug it into a USB port of its own")
    return {"type": "opencv", "index_or_path": str(paths[0])}


def listed(cameras: Sequence[Plugged]) -> str:
    """Format a list of cameras for a message."""
    return ", ".join(map(str, cameras)) or "none"


def _why_no_label() -> str:
    """Explain why the number on a RealSense's label is unknown; only librealsense can read this number."""
    try:
        library()
    except CameraError as error:
        return f"The number on a RealSense's label is not known, because {error}"
    return f"librealsense has no right to read it: `{as_root('yam-setup-can --rights')}`, then log in again"
