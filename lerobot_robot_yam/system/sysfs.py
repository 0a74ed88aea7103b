"""Hardware in sysfs, the kernel's file system: USB devices, and CAN interfaces with their adapters."""

import re
from dataclasses import dataclass
from pathlib import Path

SYSFS = Path("/sys")
KERNEL_NAME = re.compile(r"(can|slcan|vcan)\d+")  # names that the kernel assigns in order of discovery
CAN_TYPE = "280"  # type of a CAN interface in sysfs, ARPHRD_CAN of linux/if_arp.h


@dataclass(frozen=True)
class UsbDevice:
    """USB device. Attributes that sysfs does not have are None.

    Attributes:
        port: port of the device, such as "1-2.3": bus, then the port on each hub in between.
        bus: number of the USB bus (one per controller and speed class).
        number: number of the device on its bus.
        speed_mbit: negotiated link speed: 12, 480 (USB 2), 5000 (USB 3) and more.
    """

    port: str
    bus: int | None
    number: int | None
    product: str | None
    serial: str | None
    speed_mbit: float | None


@dataclass(frozen=True)
class CanAdapter:
    """CAN interface and the hardware behind it.

    Attributes:
        driver: kernel driver, such as "gs_usb"; None if the driver is unknown or there is no hardware (vcan).
        usb: USB device of the adapter; None if the adapter is not a USB device.
        place: directory of the hardware below sysfs, "/devices/…/1-2/1-2:1.0"; None if there is no hardware.
        serial: serial number of the hardware.
        dev_id, dev_port: number of this channel on a multi-channel adapter, such as "0x1" and "1". Drivers set one or
            both.
    """

    name: str
    driver: str | None
    usb: UsbDevice | None
    place: str | None
    serial: str | None
    dev_id: str | None
    dev_port: str | None

    @property
    def usb_interface(self) -> str | None:
        """USB interface of this channel, such as "1-2:1.0"; None if the adapter is not a USB device."""
        return Path(self.place).name if self.usb and self.place else None

    @property
    def number(self) -> tuple[str | None, str | None]:
        """Numbers that distinguish this channel from other channels of its adapter."""
        return self.dev_id, self.dev_port


def text_of(path: Path) -> str | None:
    """Read a small sysfs file, stripped; None if the file is empty or cannot be read."""
    try:
        return path.read_text(errors="replace").strip() or None
    except OSError:
        return None


def label_of(path: Path) -> str | None:
    """Read a text that a device gives, such as its serial number; control characters, which terminals obey, become ?"""
    text = text_of(path)
    return text and "".join(character if character.isprintable() else "?" for character in text)


def usb_device(directory: Path) -> UsbDevice | None:
    """Find the USB device to which a sysfs directory belongs; None if the hardware is not a USB device."""
    for place in (directory, *directory.parents):
        if text_of(place / "idVendor") is not None:
            bus, number, speed = (text_of(place / name) or "" for name in ("busnum", "devnum", "speed"))
            return UsbDevice(
                port=place.name,
                bus=int(bus) if bus.isdigit() else None,
                number=int(number) if number.isdigit() else None,
                product=label_of(place / "product"),
                serial=label_of(place / "serial"),
                speed_mbit=float(speed) if speed.replace(".", "", 1).isdigit() else None,
            )
    return None


def read_adapters(sysfs: Path = SYSFS) -> list[CanAdapter]:
    """List all CAN interfaces in a sysfs tree, sorted by name."""
    found = (read_adapter(path) for path in sorted((sysfs / "class" / "net").glob("*")))
    return [adapter for adapter in found if adapter is not None]


def read_adapter(interface: Path) -> CanAdapter | None:
    """Read the CAN interface in a directory of `class/net`; None if the directory is not a CAN interface.

    The link `device` leads to the USB interface ("1-2.3:1.0"), whose parent is the adapter. Other hardware (SPI) has no
    such parent.
    """
    if text_of(interface / "type") != CAN_TYPE:
        return None
    place = (interface / "device").resolve() if (interface / "device").exists() else None
    driver = place / "driver" if place else None
    usb = usb_device(place) if place else None
    return CanAdapter(
        name=interface.name,
        driver=driver.resolve().name if driver and driver.exists() else None,
        usb=usb,
        place=f"/devices/{str(place).partition('/devices/')[2]}" if place else None,
        serial=usb.serial if usb else label_of(place / "serial") if place else None,
        dev_id=text_of(interface / "dev_id"),
        dev_port=text_of(interface / "dev_port"),
    )
