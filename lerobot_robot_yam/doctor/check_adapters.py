"""Check that each CAN adapter's name is tied to the adapter; otherwise arms may be swapped unnoticed."""

import re
from collections.abc import Sequence
from pathlib import Path

from lerobot_robot_yam.doctor.kit.findings import Section
from lerobot_robot_yam.system.own_commands import as_root
from lerobot_robot_yam.system.sysfs import KERNEL_NAME, CanAdapter, text_of

RULES_DIRECTORIES = (Path("/etc/udev/rules.d"), Path("/usr/lib/udev/rules.d"))
_PORT = re.compile(r'KERNELS==|ID_PATH|DEVPATH=="[^"]*-[\d*]')  # does not match "*:1.0/net/*", which fits any device
_NAME = as_root("yam-setup-can --no-rights")


def read_rules(directories: Sequence[Path]) -> list[str]:
    """Read the lines of all udev rules, without comments."""
    lines: list[str] = []
    for directory in directories:
        for path in sorted(directory.glob("*.rules")):
            lines += (text_of(path) or "").splitlines()
    return [line.strip() for line in lines if not line.lstrip().startswith("#")]


def check_adapters(
    adapters: Sequence[CanAdapter], wanted: Sequence[str], rules: Sequence[str], section: Section
) -> None:
    """Add rows for all adapters, and findings for wanted adapters: names that may change, duplicate serial numbers."""
    for adapter in adapters:
        usb = adapter.usb
        section.rows.append(
            {
                "name": adapter.name,
                "driver": adapter.driver,
                "product": usb and usb.product,
                "serial": usb and usb.serial,
                "port": adapter.usb_interface,
                "number": adapter.dev_id,
                "named_by": _named_by(adapter, rules),
            }
        )
        if usb is not None and adapter.name in wanted:
            _check_name(adapter, adapters, rules, section)


def _check_name(adapter: CanAdapter, adapters: Sequence[CanAdapter], rules: Sequence[str], section: Section) -> None:
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
        section.problem(name, what, _NAME if KERNEL_NAME.fullmatch(name) else f"{_NAME} {name}")
    elif KERNEL_NAME.fullmatch(name) and by == "order of discovery":
        what = "the name follows the order of discovery"
        if sum(a.usb is not None for a in adapters) > 1:
            section.warn(name, f"{what}: with several adapters arms may be swapped at the next start", _NAME)
        else:
            section.note(name, what, _NAME)


def _named_by(adapter: CanAdapter, rules: Sequence[str]) -> str | None:
    """Return the property to which a udev rule ties this name, or None if the property is unknown."""
    naming = [line for line in rules if re.search(rf'NAME:?="{re.escape(adapter.name)}"', line)]
    if any(_PORT.search(line) for line in naming):
        return "USB port"
    if any("serial" in line.lower() for line in naming):
        return "serial number"
    if naming:
        return None
    return "order of discovery" if KERNEL_NAME.fullmatch(adapter.name) else None
