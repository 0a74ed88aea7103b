"""Whether a name is free: other udev rules, .link files and interfaces may have it, or name the same adapter."""

import re
from collections.abc import Collection, Iterator
from pathlib import Path

from lerobot_robot_yam.errors import SetupError
from lerobot_robot_yam.setup.adapter_rules import RULES, NamedAdapter

_RULES = ("etc/udev/rules.d", "run/udev/rules.d", "usr/lib/udev/rules.d", "lib/udev/rules.d")
_LINKS = ("etc/systemd/network", "run/systemd/network", "usr/lib/systemd/network", "lib/systemd/network")


def check_free(root: Path, named: NamedAdapter, interface: str, ours: Collection[str]) -> None:
    """Refuse a name that something else gives, and an adapter that something else names.

    Args:
        root: of the computer.
        named: the name, and the adapter that shall have it.
        interface: what the adapter is called now.
        ours: names that our rules give already.

    Raises:
        SetupError: says where, and what to do.
    """
    for path, number, line in _lines(root, _RULES, "*.rules"):
        given = re.search(r'\bNAME:?="([^"]*)"', line)
        if given is None:
            continue
        where = f"/{path}:{number}"
        if given[1] == named.name:
            raise SetupError(f"the name {named.name} is taken by {where}: take that line out, or choose another name")
        marks = [mark for mark in (named.serial, named.place.rpartition("/")[2]) if mark]
        if any(f'"{mark}"' in line for mark in marks):
            raise SetupError(f"{interface} is named {given[1]} by {where}: take that line out first")
    for path, number, line in _lines(root, _LINKS, "*.link"):
        if re.fullmatch(rf"Name\s*=\s*{named.name}", line):
            raise SetupError(f"the name {named.name} is taken by /{path}:{number}: take that file out")
    there = (root / "sys/class/net" / named.name).exists()
    if there and named.name != interface and named.name not in ours:
        raise SetupError(f"the name {named.name} is taken by a network interface: choose another name")


def _lines(root: Path, directories: tuple[str, ...], pattern: str) -> Iterator[tuple[str, int, str]]:
    """Path below the root, number and text of each line that is no comment."""
    seen = set()
    for directory in directories:
        for path in sorted((root / directory).glob(pattern)):
            if path.resolve() in seen or path == root / RULES:
                continue
            seen.add(path.resolve())
            for number, line in enumerate(path.read_text(errors="replace").splitlines(), 1):
                if not line.lstrip().startswith(("#", ";")):
                    yield str(path.relative_to(root)), number, line.strip()
