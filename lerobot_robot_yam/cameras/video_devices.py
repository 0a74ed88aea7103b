"""Cameras that are plugged in, and access rights and users of their device files. No camera is opened.

Serial numbers in this module are those of the USB device, which librealsense calls `asic_serial_number`. The label of a
RealSense shows a different number, librealsense's `serial_number` (librealsense issue 4369).
"""

import grp
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from lerobot_robot_yam.errors import CameraError
from lerobot_robot_yam.system.own_commands import as_root
from lerobot_robot_yam.system.sysfs import UsbDevice, label_of, text_of, usb_device

ROOT = Path("/")
USB3_MBIT = 5000.0
_INTEL = "8086"  # Intel's USB vendor id
_LINKS = ("by-id", "by-path")
_REALSENSE = re.compile(r"RealSense.*\bD?(4\d\d[a-z]?)\b", re.IGNORECASE)


@dataclass(frozen=True)
class VideoDevice:
    """Camera in sysfs.

    Attributes:
        name: the kernel's name; None if sysfs has no name.
        usb: USB device of the camera; None for other buses.
        nodes: /dev/video0, …; a camera usually has several.
        links: stable paths of the nodes below /dev/v4l, by-id first.
        usb_node: /dev/bus/usb/001/004, which librealsense opens; None if sysfs has no bus and device number.
    """

    name: str | None
    usb: UsbDevice | None
    nodes: tuple[Path, ...]
    links: tuple[Path, ...] = ()
    usb_node: Path | None = None

    def __str__(self) -> str:
        return f"{self.model} {self.serial or 'without serial number'} ({self.place})"

    @property
    def place(self) -> str:
        """Location of the camera: the USB port, else its nodes."""
        return f"USB {self.usb.port}" if self.usb else ", ".join(map(str, self.nodes))

    @property
    def label(self) -> str:
        """Name, nodes and USB port, for messages about the camera's link."""
        nodes = "/".join(node.name for node in self.nodes) or "no video node"
        return f"{self.name or 'camera'} ({nodes}{', USB ' + self.usb.port if self.usb else ''})"

    @property
    def model(self) -> str:
        """Model: "D405" for a RealSense, else the manufacturer's name of the camera."""
        return model_of((self.usb.product if self.usb else None) or self.name or "camera")

    @property
    def serial(self) -> str | None:
        """Serial number of the USB device, None if it has none."""
        return self.usb.serial if self.usb else None

    @property
    def speed_mbit(self) -> float | None:
        """Negotiated speed of the camera's USB link, Mbit/s; None if sysfs does not list a speed."""
        return self.usb.speed_mbit if self.usb else None

    @property
    def slow(self) -> bool:
        """Whether the camera's USB link is known to be slower than USB 3."""
        return self.speed_mbit is not None and self.speed_mbit < USB3_MBIT

    @property
    def realsense(self) -> bool:
        """Whether the camera is an Intel RealSense."""
        return "realsense" in f"{self.name} {self.usb.product if self.usb else ''}".lower()

    @property
    def stereo_colour(self) -> bool:
        """Whether the stereo module provides the camera's colour: a D405 has no colour module."""
        return self.realsense and self.model == "D405"


def video_devices(root: Path = ROOT, sysfs: Path | None = None) -> list[VideoDevice]:
    """List all cameras: each device with a video node, and each RealSense without one (librealsense may have claimed
    the RealSense).

    Args:
        root: file system root; tests pass a temporary folder.
        sysfs: root of sysfs; by default `sys` below `root`.
    """
    sysfs = sysfs or root / "sys"
    found: dict[str, tuple[str | None, UsbDevice | None, list[Path]]] = {}
    nodes = (sysfs / "class" / "video4linux").glob("video*")
    for node in sorted(nodes, key=lambda path: (len(path.name), path.name)):
        device = node / "device"
        usb = usb_device(device.resolve()) if device.exists() else None
        entry = found.setdefault(usb.port if usb else node.name, (label_of(node / "name"), usb, []))
        entry[2].append(root / "dev" / node.name)
    for device in sorted((sysfs / "bus" / "usb" / "devices").glob("*")):
        if ":" not in device.name and text_of(device / "idVendor") == _INTEL:
            usb = usb_device(device.resolve())
            if usb and "realsense" in (usb.product or "").lower():
                found.setdefault(usb.port, (usb.product, usb, []))
    links = [link for kind in _LINKS for link in sorted((root / "dev/v4l" / kind).glob("*")) if link.is_symlink()]
    return [
        VideoDevice(
            name=name,
            usb=usb,
            nodes=tuple(nodes),
            links=tuple(link for link in links if os.path.basename(os.readlink(link)) in [node.name for node in nodes]),
            usb_node=root / f"dev/bus/usb/{usb.bus:03d}/{usb.number:03d}" if usb and usb.bus and usb.number else None,
        )
        for name, usb, nodes in found.values()
    ]


def model_of(name: str) -> str:
    """Shorten a RealSense's USB or librealsense name to the model, such as "D435i"; return other names unchanged."""
    number = _REALSENSE.search(name)
    return f"D{number[1].lower()}" if number else name


def holders(paths: Sequence[Path]) -> list[tuple[int, str]]:
    """List pid and name of other processes that have one of the files open; root is needed to see other users'."""
    wanted = {os.path.realpath(path) for path in paths}
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            files = {os.readlink(entry) for entry in os.scandir(process / "fd")}
            if int(process.name) != os.getpid() and files & wanted:
                found.append((int(process.name), (process / "comm").read_text().strip()))
        except OSError:
            continue  # the process has ended, or belongs to another user
    return sorted(found)


def in_use(paths: Sequence[Path]) -> str:
    """Explain which processes have the files open, and what to do."""
    who = [f"process {pid} ({name})" for pid, name in holders(paths)]
    if not who:
        return "no process of yours has it open; `sudo fuser -v /dev/video*` shows others. Else plug it in again"
    return f"{' and '.join(who)} {'has' if len(who) == 1 else 'have'} it open: end that program first"


def check_rights(path: Path) -> None:
    """Check that this user may read and write a device file.

    Raises:
        CameraError: the file is missing, or this user has no access; the message names the group with access.
    """
    try:
        status = path.stat()
    except OSError as error:
        raise CameraError(f"{path} is not there: {error.strerror}") from error
    if os.access(path, os.R_OK | os.W_OK, effective_ids=True):
        return
    try:
        group = grp.getgrgid(status.st_gid).gr_name
    except KeyError:
        group = str(status.st_gid)
    remedy = (
        f"`{as_root('yam-setup-can --rights')}` gives it to the group video"
        if group == "root"
        else f"join the group {group} (`sudo usermod -aG {group} $USER`)"
    )
    raise CameraError(f"no right to open {path}: {remedy}, then log in again")
