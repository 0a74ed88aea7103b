"""Give the CAN adapters permanent names, have their links brought up, and give the rights needed for driving arms.

sudo "$(which yam-setup-can)"                       asks for one adapter after another; rights for who calls sudo
sudo "$(which yam-setup-can)" --wrist               asks to turn each arm's wrist instead; the arms need power
sudo "$(which yam-setup-can)" can_follower_l=can0   gives this name to the adapter that is can0 now
yam-setup-can --dry-run                             shows what would change
yam-setup-can --list                                shows adapters and names
sudo "$(which yam-setup-can)" --reset               takes all links down and up; with names, only these
sudo "$(which yam-setup-can)" --undo                takes back all that it has ever changed

A name is tied to the adapter's serial number, or to its USB port if the serial number is not unique. Energises
nothing. Exit status: 0 done; 1 it cannot be done; 2 wrong arguments; 130 interrupted: run again to continue.
"""

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.commands.lib.arm_command import open_buses, place_of
from lerobot_robot_yam.commands.lib.command_line import command_parser, run_command
from lerobot_robot_yam.commands.lib.dialogue import agreed, ask, need_terminal, say, table, tell, typed_line
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
from lerobot_robot_yam.setup.rights import rights_changes, user_of
from lerobot_robot_yam.setup.system_files import Change, SystemFiles
from lerobot_robot_yam.setup.system_tools import UNIT, UNIT_TEXT, SystemTools, check_undriven
from lerobot_robot_yam.system.own_commands import as_root
from lerobot_robot_yam.system.paths import user_path
from lerobot_robot_yam.system.sysfs import CanAdapter, read_adapters

NAMES = ("can_follower_l", "can_follower_r", "can_leader_l", "can_leader_r")  # names in the shipped run configs
_PLUG = "plug in its adapter; if it is plugged in, pull it out and plug it in again"
_WRIST = "turn its wrist by hand, a hand's width to and fro"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `yam-setup-can`; return its exit status."""
    epilog = f"All but --dry-run and --list takes root. Where `which` finds nothing: {as_root('yam-setup-can')}"
    parser = command_parser("yam-setup-can", __doc__, epilog=epilog)
    parser.add_argument(
        "names",
        nargs="*",
        metavar="NAME[=INTERFACE]",
        help=f"names to give, anew if they are given (default: those of {', '.join(NAMES)} that are not)",
    )
    instead = parser.add_mutually_exclusive_group()
    instead.add_argument("--list", action="store_true", help="show adapters and names, change nothing")
    instead.add_argument("--rights", action="store_true", help="give the rights, no names")
    instead.add_argument("--no-rights", action="store_true", help="give names, no rights")
    instead.add_argument("--reset", action="store_true", help="take links down and up: NAMEs, or all")
    instead.add_argument("--undo", action="store_true", help="take back all changes of names and rights")
    parser.add_argument("--wrist", action="store_true", help="find arms by their wrists, turned by hand")
    parser.add_argument("--user", help="who gets the rights (default: who calls sudo)")
    parser.add_argument("--dry-run", action="store_true", help="show what would change, change nothing")
    parser.add_argument("--yes", action="store_true", help="do not ask before changes")
    parser.add_argument("--root", type=user_path, default=Path("/"), help="another computer's files: etc, sys, var")
    parser.add_argument("--rig", help="with --wrist: a virtual rig whose channels are named as the adapters")
    args = parser.parse_args(arguments)
    return run_command("yam-setup-can", lambda: _set_up(args, Naming(args)))


class Naming:
    """Dialogue that names the CAN adapters of the computer whose files are below `args.root`."""

    def __init__(self, args: argparse.Namespace):
        self.files, self.dry, self.sure = SystemFiles(args.root), args.dry_run, args.yes
        self.tools = SystemTools(self.files, tell, self.dry)
        self.named = where_they_are(parse_rules(self.files.read(RULES)), self.adapters)

    @property
    def adapters(self) -> list[CanAdapter]:
        """Adapters that are plugged in at the moment."""
        return read_adapters(self.files.root / "sys")

    def adapter(self, interface: str) -> CanAdapter:
        """Return the adapter with this interface name. Raises SetupError: no adapter has this name."""
        adapters = {adapter.name: adapter for adapter in self.adapters}
        if interface not in adapters:
            there = ", ".join(adapters) or "none; plug one in (`lsusb` lists what is plugged in)"
            raise SetupError(f"there is no CAN adapter {interface!r}; there are: {there}")
        return adapters[interface]

    def assign(self, wanted: Mapping[str, str]) -> bool:
        """Give names to interfaces (`wanted`: name -> interface), after confirmation; return whether the user agreed.

        Raises:
            SetupError: an adapter is missing, a name is taken, or adapters are indistinguishable; nothing was changed.
            ChannelInUseError: a session drives an arm through one of the adapters.
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
        """Show changes, ask, and apply them; return whether the user agreed. `undo`: the changes undo earlier ones.

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
        """Ask for the adapter of each name in turn, and name the adapter before the next question.

        Args:
            names: names for the adapters, in the order of the questions.
            place: fields of `place_of`, to find an arm by a turn of its wrist; None: to find an adapter by plugging in.

        Raises:
            YamError: the terminal was closed, or no arm replies. The names given so far are kept.
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
        """Return the interface that the user shows or types; "q" to quit, "" to skip this name."""
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
        """Return a table of all names and adapters, with the properties that identify each adapter."""
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


def _set_up(args: argparse.Namespace, naming: Naming) -> int:
    if args.list:
        say(naming.table())
        return 0
    if not args.dry_run:
        naming.files.check_writable()
    if args.reset:
        _reset(naming, args.names)
    elif args.undo:
        _undo(naming)
    else:
        if not args.no_rights:
            _give_rights(naming, args.user or user_of(os.environ))
        if not args.rights:
            _name(naming, args)
    return 0


def _reset(naming: Naming, names: Sequence[str]) -> None:
    adapters = [naming.adapter(name) for name in names] or naming.adapters
    if not adapters:
        raise SetupError("there is no CAN adapter; plug one in (`lsusb` lists what is plugged in)")
    check_undriven([adapter.name for adapter in adapters])
    for adapter in adapters:
        naming.tools.reset(adapter)


def _undo(naming: Naming) -> None:
    changes, left = naming.files.undo_changes()
    if not naming.make(changes, undo=True):
        return
    if not naming.dry:
        naming.files.forget()
        for path in left:
            tell(f"/{path} was left as it is: it was changed by hand; delete what you do not want")
    if changes:
        tell("adapters keep their names until they are plugged in again; groups until the next login")


def _give_rights(naming: Naming, user: str | None) -> None:
    if user is None:
        raise SetupError("root needs no rights: say who drives the arms (--user NAME), or give --no-rights")
    tell(f"Rights of {user}: real-time scheduling, locked memory, cameras, uinput (raw CAN needs none)")
    changes = rights_changes(naming.files, user)
    if naming.make(changes) and changes and not naming.dry:
        tell(f"{user} has them from the next login on")


def _name(naming: Naming, args: argparse.Namespace) -> None:
    pairs = dict(word.split("=", 1) for word in args.names if "=" in word)
    if pairs:
        naming.assign(pairs)
    given = [entry.name for entry in naming.named]
    names = [word for word in args.names if "=" not in word]
    if not args.names:
        names = [name for name in NAMES if name not in given]
        for name in given:
            tell(f"{name} is tied already")
    if names:
        need_terminal(False)
        if args.wrist and not args.rig:
            _reset(naming, ())
        naming.guide(names, place_of(None, args.rig) if args.wrist else None)
    tell(naming.table())


def _described(adapter: CanAdapter) -> str:
    usb = adapter.usb
    return f"{adapter.name} (serial {usb.serial or 'none'}, port {usb.port})" if usb else adapter.name


if __name__ == "__main__":
    sys.exit(main())
