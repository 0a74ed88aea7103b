"""Naming CAN adapters with a person at the terminal: which adapter is it, show what changes, ask, change it."""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import can

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.commands.lib.arm_command import own_bus
from lerobot_robot_yam.commands.lib.dialogue import agreed, ask, table, tell, typed_line
from lerobot_robot_yam.errors import SetupError
from lerobot_robot_yam.setup.adapter_rules import (
    RULES,
    check_free,
    identify,
    parse_rules,
    rules_text,
    where_they_are,
    with_adapter,
)
from lerobot_robot_yam.setup.adapter_watch import PlugWatch, WristWatch
from lerobot_robot_yam.setup.system_files import Change, SystemFiles
from lerobot_robot_yam.setup.system_tools import UNIT, UNIT_TEXT, SystemTools, check_undriven
from lerobot_robot_yam.system.sysfs import CanAdapter, read_adapters

_PLUG = "plug in its adapter; if it is plugged in, pull it out and plug it in again"
_WRIST = "turn its wrist by hand, a hand's width to and fro"


class Naming:
    """Names adapters of one computer.

    Args:
        files, tools: of the computer.
        dry: only show what would change.
        sure: do not ask.
    """

    def __init__(self, files: SystemFiles, tools: SystemTools, dry: bool, sure: bool):
        self.files, self.tools, self.dry, self.sure = files, tools, dry, sure
        self.named = where_they_are(parse_rules(files.read(RULES)), self.adapters)

    @property
    def adapters(self) -> list[CanAdapter]:
        """What is plugged in now."""
        return read_adapters(self.files.root / "sys")

    def adapter(self, interface: str) -> CanAdapter:
        """The adapter that has this name now.

        Raises:
            SetupError: there is none.
        """
        adapters = {adapter.name: adapter for adapter in self.adapters}
        if interface not in adapters:
            there = ", ".join(adapters) or "none; plug one in (`lsusb` lists what is plugged in)"
            raise SetupError(f"there is no CAN adapter {interface!r}; there are: {there}")
        return adapters[interface]

    def assign(self, wanted: Mapping[str, str]) -> bool:
        """Give names to interfaces, after a question; returns whether the person agreed.

        Raises:
            SetupError: no such adapter, a name that is taken, adapters that cannot be told apart; nothing was changed.
            ChannelInUseError: a session drives one of them.
        """
        named, adapters = self.named, self.adapters
        for name, interface in wanted.items():
            new = identify(name, self.adapter(interface), adapters)
            check_free(self.files.root, new, interface, [entry.name for entry in named])
            named = with_adapter(named, new)
        lost = [entry.name for entry in self.named if entry.name not in [kept.name for kept in named]]
        if lost:
            tell(f"{', '.join(lost)} will be no name any more: its adapter gets another")
        changes = self.files.change_to(RULES, rules_text(named, adapters)) + self.files.change_to(UNIT, UNIT_TEXT)
        touched = {name: interface for name, interface in wanted.items() if changes or interface != name}
        if not self.dry:
            check_undriven(list(touched.values()))
        if not self.make(changes):
            return False
        self.named = named
        for name, interface in touched.items():
            if not self.tools.rename(interface, name):
                tell(f"{interface} is NOT {name} yet: unplug all adapters and plug them in again, or restart")
        return True

    def make(self, changes: Sequence[Change], undo: bool = False) -> bool:
        """Show changes, or those that undo all; ask, and make them; return whether the person agreed.

        Raises:
            SetupError: a file cannot be written.
        """
        if not changes:
            tell("there is nothing to undo" if undo else "nothing to change")
        for change in changes:
            tell(change.shown())
        if changes and not self.dry:
            if not self.sure and not agreed("Undo these changes?" if undo else "Make these changes?"):
                tell("nothing was undone" if undo else "nothing was changed")
                return False
            (self.files.write if undo else self.files.apply)(changes)
        self.tools.load(changes)
        return True

    def guide(self, names: Sequence[str], place: Mapping[str, Any] | None) -> None:
        """Ask for the adapter of each name, one after another. Each is done before the next is asked for.

        Args:
            names: to be given.
            place: where the arms are, to find them by their wrists; None: adapters are plugged in.

        Raises:
            YamError: the terminal has gone, or no arm answers. The names that were given stay.
        """
        for name in names:
            while True:
                try:
                    found = self._found(name, place)
                    if found == "q":
                        return
                    if not found or self.assign({name: found}):
                        break
                except SetupError as error:
                    tell(f"{error}")

    def _found(self, name: str, place: Mapping[str, Any] | None) -> str:
        """Return the interface that the person shows or types, or "q"; empty to skip this name."""
        there = ", ".join(adapter.name for adapter in self.adapters)
        question = f"\n{name}: {{}}.\nOr type its present name{f' ({there})' if there else ''}; Enter skips it, q ends."
        if place is not None:
            arms = [ArmConfig(name=adapter.name, channel=adapter.name, **place) for adapter in self.adapters]
            with open_buses(arms) as buses:
                wrists = WristWatch(buses)
                tell(question.format(_WRIST))
                channel, line = wrists.wait(typed_line, tell)
            if channel:
                tell(f"{channel} it is")
            return channel or line
        plugs = PlugWatch(self.files.root / "sys")
        tell(question.format(_PLUG))
        plugged = plugs.wait(typed_line, tell)
        if isinstance(plugged, str):
            return plugged
        tell(f"found {', '.join(map(_described, plugged))}")
        if len(plugged) == 1:
            return plugged[0].name
        return ask(f"This adapter has {len(plugged)} channels. Which one is for {name}?")

    def table(self) -> str:
        """All names and adapters, with what ties them."""
        adapters = self.adapters
        rows = []
        for adapter in adapters:
            usb = adapter.usb
            ours = adapter.name in [entry.name for entry in self.named]
            marks = (usb and usb.product, usb and usb.serial, adapter.usb_interface, adapter.dev_id)
            rows.append([adapter.name, *(mark or "-" for mark in marks), "yes" if ours else "no"])
        present = [adapter.name for adapter in adapters]
        rows += [[entry.name, "not plugged in", *"---", "yes"] for entry in self.named if entry.name not in present]
        return table(["name", "product", "serial", "USB port", "channel", "tied"], rows)


@contextlib.contextmanager
def open_buses(arms: Sequence[ArmConfig]) -> Iterator[dict[str, can.BusABC]]:
    """Open channels of arms that nobody else drives, by name. Raises as `own_bus`."""
    with contextlib.ExitStack() as stack:
        yield {config.channel: stack.enter_context(own_bus(config)) for config in arms}


def _described(adapter: CanAdapter) -> str:
    usb = adapter.usb
    return f"{adapter.name} (serial {usb.serial or 'none'}, port {usb.port})" if usb else adapter.name
