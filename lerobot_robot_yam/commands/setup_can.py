"""Name the CAN adapters for good, have their links brought up, and give the rights that driving arms takes.

sudo "$(which yam-setup-can)"                       asks for one adapter after another; rights for who calls sudo
sudo "$(which yam-setup-can)" --wrist               asks to turn each arm's wrist instead; the arms need power
sudo "$(which yam-setup-can)" can_follower_l=can0   gives this name to the adapter that is can0 now
yam-setup-can --dry-run                             shows what would change
yam-setup-can --list                                shows adapters and names
sudo "$(which yam-setup-can)" --reset               takes all links down and up; with names, only these
sudo "$(which yam-setup-can)" --undo                takes back all that it has ever changed

A name is tied to the adapter's serial number, or to its USB port if the serial number is not the only one. Energises
nothing. Exit status: 0 done; 1 it cannot be done; 2 wrong arguments; 130 interrupted: run it again, it goes on.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from lerobot_robot_yam.commands.lib.arm_command import place_of
from lerobot_robot_yam.commands.lib.can_naming import Naming
from lerobot_robot_yam.commands.lib.command_line import command_parser, run_command
from lerobot_robot_yam.commands.lib.dialogue import need_terminal, tell
from lerobot_robot_yam.errors import SetupError
from lerobot_robot_yam.setup.rights import rights_changes, user_of
from lerobot_robot_yam.setup.system_files import SystemFiles
from lerobot_robot_yam.setup.system_tools import SystemTools, check_undriven
from lerobot_robot_yam.system.own_commands import as_root
from lerobot_robot_yam.system.paths import user_path

NAMES = ("can_follower_l", "can_follower_r", "can_leader_l", "can_leader_r")  # of the shipped run configs


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `yam-setup-can`; returns the exit status."""
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
    return run_command("yam-setup-can", lambda: _set_up(args))


def _set_up(args: argparse.Namespace) -> int:
    files = SystemFiles(args.root)
    naming = Naming(files, SystemTools(files, tell, args.dry_run), args.dry_run, args.yes)
    if args.list:
        sys.stdout.write(naming.table() + "\n")
        return 0
    if not args.dry_run:
        files.check_writable()
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


if __name__ == "__main__":
    sys.exit(main())
