"""The CAN adapters of a computer, from sysfs: `class/net/<interface>/device` leads to the hardware."""

import re
from dataclasses import dataclass
from pathlib import Path

from lerobot_robot_yam.doctor.kit.usb import UsbDevice, text_of, usb_device

KERNEL_NAME = re.compile(r"(can|slcan|vcan)\d+")  # given in the order of discovery
CAN_TYPE = "280"  # ARPHRD_CAN


@dataclass(frozen=True)
class Adapter:
    """One CAN interface and the hardware behind it.

    Attributes:
        driver: kernel driver, such as "gs_usb"; None when it is unknown or there is no hardware (vcan).
        usb: the USB device, None when it is not USB.
        place: directory of the hardware below sysfs, "/devices/…/1-2/1-2:1.0"; None when there is no hardware.
        dev_id, dev_port: number of this channel on an adapter with several, such as "0x1" and "1". Drivers set one of
            them, or both.
    """

    name: str
    driver: str | None
    usb: UsbDevice | None
    place: str | None
    dev_id: str | None
    dev_port: str | None

    @property
    def usb_interface(self) -> str | None:
        """ "1-2:1.0", the place of this function of the USB device."""
        return Path(self.place).name if self.usb and self.place else None

    @property
    def number(self) -> tuple[str | None, str | None]:
        """What tells this channel from the others of its adapter."""
        return self.dev_id, self.dev_port


def read_adapters(sysfs: Path) -> list[Adapter]:
    """All CAN interfaces of a sysfs tree, by name."""
    found = []
    for interface in sorted((sysfs / "class" / "net").glob("*")):
        if text_of(interface / "type") != CAN_TYPE:
            continue
        device = interface / "device"
        place = device.resolve() if device.exists() else None
        driver = place / "driver" if place else None
        found.append(
            Adapter(
                name=interface.name,
                driver=driver.resolve().name if driver and driver.exists() else None,
                usb=usb_device(place) if place else None,
                place=f"/devices/{str(place).partition('/devices/')[2]}" if place else None,
                dev_id=text_of(interface / "dev_id"),
                dev_port=text_of(interface / "dev_port"),
            )
        )
    return found
