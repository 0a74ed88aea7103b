"""Cameras and the USB links that they hang on, from sysfs. No camera is opened.

A RealSense on a USB 2 link offers fewer streams at lower rates; two cameras on one USB 2 bus share 480 Mbit/s.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from lerobot_robot_yam.doctor.kit.findings import Section
from lerobot_robot_yam.doctor.kit.usb import UsbDevice, text_of, usb_device
from lerobot_robot_yam.system.own_commands import install_extra

DEV = Path("/dev")
_USB3_MBIT = 5000.0
_INTEL = "8086"


@dataclass(frozen=True)
class Camera:
    """One camera: its video nodes ("video0", …; several per camera are usual), name and USB link."""

    name: str | None
    nodes: tuple[str, ...]
    usb: UsbDevice | None

    @property
    def realsense(self) -> bool:
        """Whether it is an Intel RealSense."""
        names = f"{self.name} {self.usb.product if self.usb else ''}"
        return "realsense" in names.lower()

    @property
    def label(self) -> str:
        """How messages call it."""
        nodes = "/".join(self.nodes) or "no video node"
        return f"{self.name or 'camera'} ({nodes}{', USB ' + self.usb.port if self.usb else ''})"


def read_cameras(sysfs: Path) -> list[Camera]:
    """Cameras of a sysfs tree: everything with a video node, and RealSense devices without one."""
    devices: dict[str, tuple[str | None, UsbDevice | None, list[str]]] = {}
    nodes = (sysfs / "class" / "video4linux").glob("video*")
    for node in sorted(nodes, key=lambda path: (len(path.name), path.name)):
        device = node / "device"
        usb = usb_device(device.resolve()) if device.exists() else None
        entry = devices.setdefault(usb.port if usb else node.name, (text_of(node / "name"), usb, []))
        entry[2].append(node.name)
    for device in sorted((sysfs / "bus" / "usb" / "devices").glob("*")):
        if ":" not in device.name and text_of(device / "idVendor") == _INTEL:
            usb = usb_device(device.resolve())
            if usb and "realsense" in (usb.product or "").lower():
                devices.setdefault(usb.port, (usb.product, usb, []))
    return [Camera(name, tuple(nodes), usb) for name, usb, nodes in devices.values()]


def check_cameras(
    cameras: Sequence[Camera], configured: Mapping[str, Mapping[str, Any]], dev: Path, section: Section
) -> None:
    """Rows for all cameras; findings about slow links and about configured cameras that are not there."""
    slow: dict[int, list[Camera]] = {}
    for camera in cameras:
        usb = camera.usb
        section.rows.append(
            {
                "name": camera.name,
                "nodes": list(camera.nodes),
                "serial": usb and usb.serial,
                "port": usb and usb.port,
                "bus": usb and usb.bus,
                "speed_mbit": usb and usb.speed_mbit,
            }
        )
        if usb is None or usb.speed_mbit is None or usb.speed_mbit >= _USB3_MBIT:
            continue
        if usb.bus is not None:
            slow.setdefault(usb.bus, []).append(camera)
        if camera.realsense:
            what = f"a RealSense on a link of {usb.speed_mbit:g} Mbit/s (USB 2): streams are missing or stall"
            section.problem(camera.label, what, "plug it into a USB 3 port (blue) with a USB 3 cable")
    for bus, sharing in sorted(slow.items()):
        if len(sharing) > 1:
            names = ", ".join(camera.label for camera in sharing)
            what = f"{len(sharing)} cameras share one USB 2 bus: {names}"
            section.warn(f"USB bus {bus}", what, "move one to a port of another USB controller (lsusb -t shows them)")
    _check_configured(cameras, configured, dev, section)


def _check_configured(
    cameras: Sequence[Camera], configured: Mapping[str, Mapping[str, Any]], dev: Path, section: Section
) -> None:
    wanted = [name for name, camera in configured.items() if camera.get("type") == "intelrealsense"]
    present = sum(camera.realsense for camera in cameras)
    if len(wanted) > present:
        what = f"{len(wanted)} RealSense cameras are configured, {present} are plugged in"
        section.problem(f"cameras {', '.join(wanted)}", what, "plug the missing one in (lsusb -d 8086: lists them)")
    if wanted and find_spec("pyrealsense2") is None:
        what = "the package that LeRobot reads a RealSense with (pyrealsense2) is not installed"
        section.problem(f"cameras {', '.join(wanted)}", what, install_extra("realsense"))
    for name, camera in configured.items():
        serial = camera.get("serial_number_or_name")
        known = {c.usb.serial for c in cameras if c.usb}  # on its label, a RealSense has another number
        if camera.get("type") == "yam_realsense" and str(serial) not in known and not present:
            remedy = "plug it in, or correct the serial number (yam-cameras list)"
            section.problem(f"camera {name}", f"there is no camera {serial}", remedy)
        index = camera.get("index_or_path")
        if camera.get("type") != "opencv" or index is None:
            continue
        node = dev / f"video{index}" if isinstance(index, int) else Path(str(index))
        if node.is_absolute() and node.is_relative_to("/dev"):
            node = dev / node.relative_to("/dev")
        if not node.exists():
            remedy = "plug it in, or name another one (lerobot-find-cameras opencv)"
            section.problem(f"camera {name}", f"{index} is not there", remedy)
        elif node.name.removeprefix("video").isdigit():
            what = f"{index} follows the order of discovery: cameras may be swapped at the next start"
            section.note(f"camera {name}", what, "name it by a link of `ls -l /dev/v4l/by-path` in the config")
