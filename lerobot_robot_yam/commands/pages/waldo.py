"""Serve an arm to Waldo Commander, a page to jog, teach and program the arm in a browser.

yam-waldo                                       a simulated arm, and Commander's page if it is installed
yam-waldo --hardware --channel can_follower_l   the same for a real arm, which is not energised by this
yam-waldo arm                                   in another terminal: ENERGISE it; it holds where it is
yam-waldo land                                  bring it down and cut torque

HAZARD: `yam-waldo arm` energises the arm; from then on anybody who reaches Commander's page can move it. Commander's
e-stop is software: the arm holds, and torque stays on. The arm lands when `yam-waldo --hardware` ends.
"""

import argparse
import asyncio
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.commands.lib.arm_command import add_arm_arguments, with_likely_gripper
from lerobot_robot_yam.commands.lib.command_line import command_parser, run_command
from lerobot_robot_yam.commands.lib.dialogue import confirm_word, need_terminal, tell
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.waldo.arm_choice import ArmChoice
from lerobot_robot_yam.waldo.wire import HOST, PORT, ask_operator_door

_WORD = "arm"
_PAGE = "waldo-commander"
_EVERYBODY = ("0.0.0.0", "::")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `yam-waldo`; return its exit status."""
    parser = command_parser("yam-waldo", __doc__)
    acts = {"serve": _serve, "arm": _arm, "land": _land}
    parser.add_argument("act", nargs="?", default="serve", choices=acts, help="what to do (default: serve)")
    parser.add_argument("--hardware", action="store_true", help="serve the real arm on --channel, not only a simulated")
    add_arm_arguments(parser, required=False)
    parser.add_argument("--calibration", metavar="PATH", help="the gripper's stored stops; else it seeks its stops")
    parser.add_argument("--host", default=HOST, help=f"address of controller and page (default {HOST}: this computer)")
    parser.add_argument("--port", type=int, default=PORT, help=f"port of the controller (default {PORT})")
    parser.add_argument("--no-page", action="store_true", help="do not start Commander")
    parser.add_argument("--yes", action="store_true", help="do not ask before the arm is energised")
    args = parser.parse_args(arguments)
    return run_command("yam-waldo", lambda: acts[args.act](args))


def _serve(args: argparse.Namespace) -> int:
    from lerobot_robot_yam.waldo.controller.controller_process import serve  # imported late: only `serve` needs it

    config = _real(args) if args.hardware else None
    choice = ArmChoice(args.arm, args.gripper or ArmChoice().gripper)
    os.environ.update((choice if config is None else ArmChoice(config.arm, config.gripper)).environment())
    if args.host in _EVERYBODY:
        tell(f"HAZARD: everybody on the network can move this arm, without a password (--host {args.host})")
    page: list[subprocess.Popen[bytes]] = []

    def opened() -> None:
        page.extend(_page(args))
        what = "a simulated arm" if config is None else f"the arm on {config.channel}, not energised: yam-waldo arm"
        tell(f"serving {what}, on {args.host}:{args.port}; Ctrl-C ends it")

    try:
        asyncio.run(serve(args.host, args.port, config, opened=opened))
    finally:
        for process in page:
            process.terminate()
            process.wait()
    return 0


def _real(args: argparse.Namespace) -> ArmConfig:
    if args.channel is None:
        raise ConfigError("--hardware needs --channel, such as can_follower_l; nothing was started")
    return with_likely_gripper(args, calibration_path=args.calibration)


def _page(args: argparse.Namespace) -> list[subprocess.Popen[bytes]]:
    """Start Commander for this controller; return its process, or [] if Commander is not installed or not wanted."""
    beside = Path(sys.executable).parent / _PAGE
    program = str(beside) if beside.exists() else shutil.which(_PAGE)
    if args.no_page or program is None:
        if not args.no_page:
            tell("Waldo Commander is not installed (docs/waldo.md): serving scripts alone")
        return []
    environment = {**os.environ, "WALDO_ROBOT": "yam", "WALDO_EXCLUSIVE_START": "0"}
    return [subprocess.Popen([program, "--host", args.host], env=environment)]


def _arm(args: argparse.Namespace) -> int:
    need_terminal(args.yes)
    about = json.loads(ask_operator_door(args.port, "about"))
    tell(hazard(about["channel"], about["seeks"]))
    confirm_word(args.yes, _WORD, f"Type {_WORD} to go on:")
    tell(ask_operator_door(args.port, "arm"))
    return 0


def _land(args: argparse.Namespace) -> int:
    tell(ask_operator_door(args.port, "land"))
    return 0


def hazard(channel: str, seeks: bool) -> str:
    """Return the hazard warning that the user has to confirm before the arm is energised.

    Args:
        channel: channel of the arm.
        seeks: whether the gripper searches for its stops.
    """
    text = (
        f"HAZARD: this energises the arm on {channel}. It holds where it is. From then on whoever reaches Commander's "
        "page, or runs a script on this controller, moves it. Commander's e-stop is software: the arm holds, and "
        "torque stays on. Keep clear of its way, and the supply's switch within reach."
    )
    return text + " The gripper closes and opens fully to find its stops (see --calibration)." * seeks


if __name__ == "__main__":
    sys.exit(main())
