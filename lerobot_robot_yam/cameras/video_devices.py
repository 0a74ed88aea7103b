"""Cameras that are plugged in, from the files of sysfs and /dev. None is opened.

The serial number is that of the USB device. A RealSense has another one on its label, which librealsense shows as
`serial_number`; the USB device has its `asic_serial_number` (librealsense's issue 4369).
"""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from lerobot_robot_yam.doctor.check_cameras import read_cameras
from lerobot_robot_yam.doctor.kit.usb import text_of

ROOT = Path("/")
_LINKS = ("by-id", "by-path")
_REALSENSE = re.compile(r"RealSense.*\bD?(4\d\d[a-z]?)\b", re.IGNORECASE)


@dataclass(frozen=True)
class VideoDevice:
    """One camera.

    Attributes:
        model: "D405" of a RealSense, else the name that the maker gave it.
        serial: of the USB device, None without one.
        port: of the USB bus, "1-2.3"; None of a camera that is not USB.
        speed_mbit: of its link as negotiated; None if sysfs does not tell.
        nodes: /dev/video0, …; several per camera are usual.
        links: stable paths of them below /dev/v4l, by-id first.
        usb_node: /dev/bus/usb/001/004, by which librealsense reads it; None if sysfs does not tell.
    """

    model: str
    serial: str | None
    port: str | None
    speed_mbit: float | None
    realsense: bool
    nodes: tuple[Path, ...]
    links: tuple[Path, ...] = ()
    usb_node: Path | None = None

    def __str__(self) -> str:
        return f"{self.model} {self.serial or 'without serial number'} ({self.place})"

    @property
    def place(self) -> str:
        """Where it is: the USB port, else its nodes."""
        return f"USB {self.port}" if self.port else ", ".join(map(str, self.nodes))

    @property
    def stereo_colour(self) -> bool:
        """Whether its colour comes from the stereo module: a D405 has no other."""
        return self.realsense and self.model == "D405"


def video_devices(root: Path = ROOT) -> list[VideoDevice]:
    """Every camera of a computer whose files are below `root`."""
    found = []
    for camera in read_cameras(root / "sys"):
        usb = camera.usb
        nodes = tuple(root / "dev" / node for node in camera.nodes)
        name = usb.product if usb and usb.product else camera.name or "camera"
        found.append(
            VideoDevice(
                model=model_of(name),
                serial=usb.serial if usb else None,
                port=usb.port if usb else None,
                speed_mbit=usb.speed_mbit if usb else None,
                realsense=camera.realsense,
                nodes=nodes,
                links=_links(root, camera.nodes),
                usb_node=_usb_node(root, usb.port) if usb else None,
            )
        )
    return found


def model_of(name: str) -> str:
    """D435i for the name that a RealSense has on the USB bus or in librealsense; other names as they are."""
    number = _REALSENSE.search(name)
    return f"D{number[1].lower()}" if number else name


def _links(root: Path, nodes: Sequence[str]) -> tuple[Path, ...]:
    links = [link for kind in _LINKS for link in sorted((root / "dev/v4l" / kind).glob("*")) if link.is_symlink()]
    return tuple(link for link in links if os.path.basename(os.readlink(link)) in nodes)


def _usb_node(root: Path, port: str) -> Path | None:
    device = root / "sys/bus/usb/devices" / port
    bus, number = text_of(device / "busnum"), text_of(device / "devnum")
    return root / f"dev/bus/usb/{int(bus):03d}/{int(number):03d}" if bus and number else None
