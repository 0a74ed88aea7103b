"""Names of CAN adapters as udev rules: each name is tied to one adapter, by serial number or else by USB port.

systemd's .link files are no alternative: they cannot distinguish the channels of an adapter, and have no effect where
predictable names are switched off, as on Raspberry Pi OS.

`check_free` checks that no other rule, .link file or interface already uses the name, or names the same adapter.
"""

import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from lerobot_robot_yam.errors import SetupError
from lerobot_robot_yam.system.sysfs import CAN_TYPE, KERNEL_NAME, CanAdapter

RULES = "etc/udev/rules.d/70-yam-can.rules"  # runs before 80-net-setup-link.rules, which keeps names given earlier
_RULES_FOLDERS = ("etc/udev/rules.d", "run/udev/rules.d", "usr/lib/udev/rules.d", "lib/udev/rules.d")
_LINK_FOLDERS = ("etc/systemd/network", "run/systemd/network", "usr/lib/systemd/network", "lib/systemd/network")
_HEAD = (
    "# Written by yam-setup-can; `yam-setup-can --undo` takes it away. Names of the arms' CAN adapters.\n"
    "# By serial number; by place (the USB port) where adapters share a serial number or have none.\n"
)
_ENTRY = re.compile(r"# (\w+): serial (.+), channel (.+), place (/devices/\S+)")
_NONE = "-"
_NAME = re.compile(r"[A-Za-z]\w{0,14}", re.ASCII)  # interface name, at most 15 characters
_SAFE_SERIAL = re.compile(r"[\w.:+-][\w .:+-]*", re.ASCII)  # serial number without udev's patterns and quotes


@dataclass(frozen=True)
class NamedAdapter:
    """Name of an adapter, and the properties that identify the adapter.

    Attributes:
        serial: serial number; None: the adapter has no usable serial number.
        channel: channel of a multi-channel adapter: "dev_id 0x1", "dev_port 1", or "function 1.1" of the USB device.
        place: path of the adapter's hardware in sysfs.
    """

    name: str
    serial: str | None
    channel: str | None
    place: str

    @property
    def device(self) -> str:
        """Place of the USB device that contains the adapter; for other hardware, the adapter's own place."""
        place = PurePosixPath(self.place)
        return str(place.parent if ":" in place.name else place)

    def same_hardware(self, other: "NamedAdapter") -> bool:
        """Return whether no rule could distinguish the two adapters."""
        return (self.serial, self.channel, _glob(self.place)) == (other.serial, other.channel, _glob(other.place))


def identify(name: str, adapter: CanAdapter, adapters: Sequence[CanAdapter]) -> NamedAdapter:
    """Tie a name to one of the connected adapters; return the entry for the rules file.

    Raises:
        SetupError: the name is not valid, or the adapter is virtual or cannot be distinguished from another adapter.
    """
    if not _NAME.fullmatch(name) or KERNEL_NAME.fullmatch(name):
        raise SetupError(
            f"{name!r} is no name for an adapter: take letters, digits and _, at most 15, and not the kernel's own "
            "(can0), which follow the order of discovery"
        )
    if adapter.place is None:
        raise SetupError(f"{adapter.name} has no hardware behind it (vcan?): it needs no name of yours")
    serial = adapter.usb.serial if adapter.usb else None
    if serial is not None and not _SAFE_SERIAL.fullmatch(serial):
        serial = None
    named = NamedAdapter(name, serial, None, adapter.place)
    others = [other for other in adapters if other.name != adapter.name]
    alike = [other for other in others if other.place == adapter.place]
    for key in ("dev_id", "dev_port"):
        value = getattr(adapter, key)
        if alike and value is not None and all(getattr(other, key) != value for other in alike):
            return replace(named, channel=f"{key} {value}")
    if alike:
        raise SetupError(
            f"this kernel does not tell {adapter.name} from {', '.join(other.name for other in alike)}, another "
            "channel of the same adapter: use Linux 6.1 or newer, or an adapter for each arm"
        )
    if any(other.usb and adapter.usb and other.usb.port == adapter.usb.port for other in others):
        return replace(named, channel=f"function {adapter.place.rpartition(':')[2]}")
    return named


def with_adapter(present: Sequence[NamedAdapter], new: NamedAdapter) -> list[NamedAdapter]:
    """Return the entries plus `new`, which replaces entries with the same name or the same adapter."""
    kept = [named for named in present if named.name != new.name and not named.same_hardware(new)]
    return sorted([*kept, new], key=lambda named: named.name)


def where_they_are(named: Sequence[NamedAdapter], adapters: Sequence[CanAdapter]) -> list[NamedAdapter]:
    """Return the entries with current places: an adapter that is named by serial number may have been moved."""

    def moved(entry: NamedAdapter) -> NamedAdapter:
        places = {a.name: a.place for a in adapters if a.usb and a.place and a.usb.serial == entry.serial}
        return entry if entry.place in places.values() else replace(entry, place=places.get(entry.name) or entry.place)

    return [moved(entry) for entry in named]


def rules_text(named: Sequence[NamedAdapter], adapters: Sequence[CanAdapter]) -> str | None:
    """Format the rules file for these names, given the connected adapters; return None if there are no names.

    Raises:
        SetupError: two names would be tied to one USB port.
    """
    if not named:
        return None
    seen = {(a.usb.serial, _glob(a.place).rpartition("/")[0]) for a in adapters if a.usb and a.place}
    seen |= {(entry.serial, _glob(entry.device)) for entry in named}
    by_place = [n for n in named if n.serial is None or sum(serial == n.serial for serial, _ in seen) > 1]
    for entry in by_place:
        rivals = [n.name for n in named if (_glob(n.place), n.channel) == (_glob(entry.place), entry.channel)]
        if len(rivals) > 1:
            raise SetupError(
                f"{' and '.join(rivals)} are in one USB port, and their serial numbers do not tell them apart: give "
                "each adapter a port for good, then name them again"
            )
    return _HEAD + "".join(_lines(entry, entry in by_place) for entry in named)


def parse_rules(text: str | None) -> list[NamedAdapter]:
    """Parse the entries of a rules file written by `rules_text`; empty without a file."""
    return [
        NamedAdapter(name, None if serial == _NONE else serial, None if channel == _NONE else channel, place)
        for name, serial, channel, place in _ENTRY.findall(text or "")
    ]


def _lines(named: NamedAdapter, by_place: bool) -> str:
    key, _, value = (named.channel or "").partition(" ")
    match = ['SUBSYSTEM=="net"', 'ACTION!="remove"', f'ATTR{{type}}=="{CAN_TYPE}"']
    if by_place:
        match.append(f'DEVPATH=="{_glob(named.place)}/net/*"')
    else:
        match.append(f'ATTRS{{serial}}=="{named.serial}"')
        if key == "function":
            match.append(f'DEVPATH=="*:{value}/net/*"')
    if key in ("dev_id", "dev_port"):
        match.append(f'ATTR{{{key}}}=="{value}"')
    # udev renames at the "add" event; systemd reads the properties of the following "move" event.
    # NM_UNMANAGED keeps NetworkManager away; systemd starts the unit that brings the link up.
    give = [f'NAME="{named.name}"', 'ENV{NM_UNMANAGED}="1"', 'TAG+="systemd"']
    give.append(f'ENV{{SYSTEMD_WANTS}}+="yam-can@{named.name}.service"')
    entry = f"# {named.name}: serial {named.serial or _NONE}, channel {named.channel or _NONE}, place {named.place}"
    return f"\n{entry}\n{', '.join([*match, *give])}\n"


def _glob(place: str) -> str:
    """Replace the numbers in a place that depend on the order of discovery: USB buses, controllers (xhci-hcd.1)."""
    return re.sub(r"(?<=/)\d+(?=-)", "*", re.sub(r"(?<=/usb)\d+|(?<=/xhci-hcd\.)\d+", "*", place))


def check_free(root: Path, named: NamedAdapter, interface: str, ours: Collection[str]) -> None:
    """Check that no other rule, .link file or interface uses this name, or names this adapter.

    Args:
        root: root of the computer's files.
        named: the name, with the adapter to be named.
        interface: current interface name of the adapter.
        ours: names that this package's rules already give.

    Raises:
        SetupError: the name is in use, or the adapter is named elsewhere; the message says where, and what to do.
    """
    for path, number, line in _lines_in(root, _RULES_FOLDERS, "*.rules"):
        given = re.search(r'\bNAME:?="([^"]*)"', line)
        if given is None:
            continue
        where = f"/{path}:{number}"
        if given[1] == named.name:
            raise SetupError(f"the name {named.name} is taken by {where}: take that line out, or choose another name")
        marks = [mark for mark in (named.serial, named.place.rpartition("/")[2]) if mark]
        if any(f'"{mark}"' in line for mark in marks):
            raise SetupError(f"{interface} is named {given[1]} by {where}: take that line out first")
    for path, number, line in _lines_in(root, _LINK_FOLDERS, "*.link"):
        if re.fullmatch(rf"Name\s*=\s*{named.name}", line):
            raise SetupError(f"the name {named.name} is taken by /{path}:{number}: take that file out")
    there = (root / "sys/class/net" / named.name).exists()
    if there and named.name != interface and named.name not in ours:
        raise SetupError(f"the name {named.name} is taken by a network interface: choose another name")


def _lines_in(root: Path, directories: tuple[str, ...], pattern: str) -> Iterator[tuple[str, int, str]]:
    """Yield path below the root, number and text of each line that is not a comment."""
    seen = set()
    for directory in directories:
        for path in sorted((root / directory).glob(pattern)):
            if path.resolve() in seen or path == root / RULES:
                continue
            seen.add(path.resolve())
            try:
                text = path.read_text(errors="replace")
            except OSError:  # a broken link, or no right to read: `yam-setup-can --dry-run` needs no rights
                continue
            for number, line in enumerate(text.splitlines(), 1):
                if not line.lstrip().startswith(("#", ";")):
                    yield str(path.relative_to(root)), number, line.strip()
