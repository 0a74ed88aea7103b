"""The USB device behind a network interface or a camera, from sysfs."""

from dataclasses import dataclass
from pathlib import Path

SYSFS = Path("/sys")


@dataclass(frozen=True)
class UsbDevice:
    """A USB device. None where sysfs does not tell.

    Attributes:
        port: where it is plugged in, such as "1-2.3": bus, then the port of each hub on the way.
        bus: number of the USB bus (one per controller and speed class).
        speed_mbit: of the link as negotiated: 12, 480 (USB 2), 5000 (USB 3) and more.
    """

    port: str
    bus: int | None
    product: str | None
    serial: str | None
    speed_mbit: float | None


def text_of(path: Path) -> str | None:
    """Content of a small sysfs file, None when it cannot be read or is empty."""
    try:
        return path.read_text(errors="replace").strip() or None
    except OSError:
        return None


def usb_device(directory: Path) -> UsbDevice | None:
    """The USB device that a directory of sysfs belongs to, None when it is not USB."""
    for place in (directory, *directory.parents):
        if text_of(place / "idVendor") is not None:
            bus, speed = text_of(place / "busnum"), text_of(place / "speed")
            return UsbDevice(
                port=place.name,
                bus=int(bus) if bus and bus.isdigit() else None,
                product=text_of(place / "product"),
                serial=text_of(place / "serial"),
                speed_mbit=float(speed) if speed and speed.replace(".", "", 1).isdigit() else None,
            )
    return None
