"""Check of cameras and their USB links. No camera is opened.

A RealSense on a USB 2 link offers fewer streams at lower rates; two cameras on one USB 2 bus share 480 Mbit/s.
"""

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from lerobot_robot_yam.cameras.video_devices import VideoDevice
from lerobot_robot_yam.doctor.kit.findings import Section
from lerobot_robot_yam.system.own_commands import install_extra

DEV = Path("/dev")


def check_cameras(
    cameras: Sequence[VideoDevice], configured: Mapping[str, Mapping[str, Any]], dev: Path, section: Section
) -> None:
    """Add rows for all cameras, and findings about slow links and missing configured cameras."""
    slow: dict[int | None, list[str]] = {}
    for camera in cameras:
        usb = camera.usb
        section.rows.append(
            {
                "name": camera.name,
                "nodes": [node.name for node in camera.nodes],
                "serial": camera.serial,
                "port": usb and usb.port,
                "bus": usb and usb.bus,
                "speed_mbit": camera.speed_mbit,
            }
        )
        if usb is None or not camera.slow:
            continue
        slow.setdefault(usb.bus, []).append(camera.label)
        if camera.realsense:
            what = f"a RealSense on a link of {usb.speed_mbit:g} Mbit/s (USB 2): streams are missing or stall"
            section.problem(camera.label, what, "plug it into a USB 3 port (blue) with a USB 3 cable")
    for bus, sharing in slow.items():
        if len(sharing) > 1 and bus is not None:
            what = f"{len(sharing)} cameras share one USB 2 bus: {', '.join(sharing)}"
            section.warn(f"USB bus {bus}", what, "move one to a port of another USB controller (lsusb -t shows them)")
    wanted = [name for name, camera in configured.items() if camera.get("type") == "intelrealsense"]
    present = sum(camera.realsense for camera in cameras)
    if len(wanted) > present:
        what = f"{len(wanted)} RealSense cameras are configured, {present} are plugged in"
        section.problem(f"cameras {', '.join(wanted)}", what, "plug the missing one in (lsusb -d 8086: lists them)")
    if wanted and find_spec("pyrealsense2") is None:
        what = "the package that LeRobot reads a RealSense with (pyrealsense2) is not installed"
        section.problem(f"cameras {', '.join(wanted)}", what, install_extra("realsense"))
    for name, options in configured.items():
        serial = str(options.get("serial_number_or_name"))
        # A RealSense's label may differ from sysfs: report a missing serial number only if no RealSense is plugged in.
        if options.get("type") == "yam_realsense" and not present and serial not in [c.serial for c in cameras]:
            remedy = "plug it in, or correct the serial number (yam-cameras list)"
            section.problem(f"camera {name}", f"there is no camera {serial}", remedy)
        if options.get("type") == "opencv" and options.get("index_or_path") is not None:
            _check_node(name, options["index_or_path"], dev, section)


def _check_node(name: str, index: int | str, dev: Path, section: Section) -> None:
    """Check the device node of a configured OpenCV camera. `index`: number or path of the node."""
    node = Path(f"/dev/video{index}" if isinstance(index, int) else str(index))
    if node.is_relative_to("/dev"):
        node = dev / node.relative_to("/dev")
    if not node.exists():
        remedy = "plug it in, or name another one (lerobot-find-cameras opencv)"
        section.problem(f"camera {name}", f"{index} is not there", remedy)
    elif node.name.removeprefix("video").isdigit():
        what = f"{index} follows the order of discovery: cameras may be swapped at the next start"
        section.note(f"camera {name}", what, "name it by a link of `ls -l /dev/v4l/by-path` in the config")
