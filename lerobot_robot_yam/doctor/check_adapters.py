"""Whether the names of the CAN adapters are tied to the adapters: otherwise arms are swapped silently.

From sysfs: `class/net/<interface>/device` leads to the USB interface of the adapter.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from lerobot_robot_yam.doctor.kit.findings import Section
from lerobot_robot_yam.doctor.kit.usb import UsbDevice, text_of, usb_device

RULES_DIRECTORIES = (Path("/etc/udev/rules.d"), Path("/usr/lib/udev/rules.d"))
RULES_FILE = "/etc/udev/rules.d/90-yam-can.rules"
_CAN_TYPE = "280"  # ARPHRD_CAN
_KERNEL_NAME = re.compile(r"(can|slcan|vcan)\d+")  # given in the order of discovery


@dataclass(frozen=True)
class Adapter:
    """One CAN interface and the hardware behind it.

    Attributes:
        driver: kernel driver, such as "gs_usb"; None when it is unknown or there is no hardware (vcan).
        usb: the USB device, None when it is not USB.
        usb_interface: "1-2:1.0", the place of this function of the device.
        number: number of this channel on an adapter with several, such as "0x1".
    """

    name: str
    driver: str | None
    usb: UsbDevice | None
    usb_interface: str | None
    number: str | None

    def rule(self, by_port: bool) -> str:
        """The udev rule that ties a name to this adapter, by serial number or by USB port."""
        match = 'SUBSYSTEM=="net", ACTION=="add"'
        if by_port or self.usb is None or self.usb.serial is None:
            match += f', KERNELS=="{self.usb_interface}"'
        else:
            match += f', ATTRS{{serial}}=="{self.usb.serial}"'
        if self.number is not None:  # the first of several, too: without it the rule would match them all
            match += f', ATTR{{dev_id}}=="{self.number}"'
        name = "CAN_NAME" if _KERNEL_NAME.fullmatch(self.name) else self.name
        return f'{match}, NAME="{name}"'


def read_adapters(sysfs: Path) -> list[Adapter]:
    """All CAN interfaces of a sysfs tree, by name."""
    found = []
    for interface in sorted((sysfs / "class" / "net").glob("*")):
        if text_of(interface / "type") != _CAN_TYPE:
            continue
        device = interface / "device"
        place = device.resolve() if device.exists() else None
        driver = place / "driver" if place else None
        usb = usb_device(place) if place else None
        found.append(
            Adapter(
                name=interface.name,
                driver=driver.resolve().name if driver and driver.exists() else None,
                usb=usb,
                usb_interface=place.name if usb and place else None,
                number=text_of(interface / "dev_id"),
            )
        )
    return found


def read_rules(directories: Sequence[Path]) -> list[str]:
    """Lines of all udev rules."""
    lines: list[str] = []
    for directory in directories:
        for path in sorted(directory.glob("*.rules")):
            lines += (text_of(path) or "").splitlines()
    return [line.strip() for line in lines if not line.lstrip().startswith("#")]


def check_adapters(adapters: Sequence[Adapter], wanted: Sequence[str], rules: Sequence[str], section: Section) -> None:
    """Rows for all adapters, findings for the wanted ones: names that may shuffle, serial numbers that repeat."""
    for adapter in adapters:
        usb = adapter.usb
        section.rows.append(
            {
                "name": adapter.name,
                "driver": adapter.driver,
                "product": usb and usb.product,
                "serial": usb and usb.serial,
                "port": adapter.usb_interface,
                "number": adapter.number,
                "named_by": _named_by(adapter, rules),
            }
        )
        if usb is not None and adapter.name in wanted:
            _check_name(adapter, adapters, rules, section)


def _check_name(adapter: Adapter, adapters: Sequence[Adapter], rules: Sequence[str], section: Section) -> None:
    usb, name = adapter.usb, adapter.name
    assert usb is not None
    twins = [a.name for a in adapters if a.usb and usb.serial and a.usb.serial == usb.serial and a.usb.port != usb.port]
    by = _named_by(adapter, rules)
    alike = [a.name for a in adapters if a.usb_interface == adapter.usb_interface and a.number == adapter.number]
    if len(alike) > 1:
        what = f"this kernel does not tell it from {', '.join(other for other in alike if other != name)}, another "
        what += "channel of the same adapter: no rule can tie a name to either, and arms are swapped"
        section.problem(name, what, "use Linux 6.1 or newer, or an adapter for each arm")
    elif twins and by != "USB port":
        what = f"its adapter has the same serial number ({usb.serial}) as that of {', '.join(twins)}: a name "
        what += "tied to it may land on either, and arms are swapped"
        section.problem(name, what, _add_rule(adapter, by_port=True))
    elif _KERNEL_NAME.fullmatch(name) and by == "order of discovery":
        what, rule = "the name follows the order of discovery", _add_rule(adapter, by_port=usb.serial is None)
        if sum(a.usb is not None for a in adapters) > 1:
            section.warn(name, f"{what}: with several adapters arms may be swapped at the next start", rule)
        else:
            section.note(name, what, rule)


def _add_rule(adapter: Adapter, by_port: bool) -> str:
    hint = ", with a name of yours for CAN_NAME" if _KERNEL_NAME.fullmatch(adapter.name) else ""
    return f"add this line to {RULES_FILE}{hint}, then plug the adapter in again: {adapter.rule(by_port)}"


def _named_by(adapter: Adapter, rules: Sequence[str]) -> str | None:
    """The property by which a udev rule gives this name; None is unknown."""
    naming = [line for line in rules if re.search(rf'NAME:?="{re.escape(adapter.name)}"', line)]
    if any("KERNELS==" in line or "ID_PATH" in line or "DEVPATH" in line for line in naming):
        return "USB port"
    if any("serial" in line.lower() for line in naming):
        return "serial number"
    if naming:
        return None
    return "order of discovery" if _KERNEL_NAME.fullmatch(adapter.name) else None
