"""Show the arms that run on this computer in a browser: where they are, what they are doing, what is wrong.

yam-view                    watch every session; it can neither slow nor stop one
yam-view --host 0.0.0.0     for browsers of other computers, too, which need the token in the address that it prints
yam-view --token            ask for a token on this computer, too, where other people have accounts
yam-view --desktop          MuJoCo's own viewer instead of a browser
yam-view --desktop --channel can_follower_l         the same, and drag the tool of an arm: SPACE watches or controls
yam-view --desktop --config_path configs/real/record.yaml    the same with the followers of a run config

The page has an emergency stop. Ctrl-C ends the page; sessions go on.

HAZARD: --channel and --config_path ENERGISE arms; they land however the window ends.
"""

import argparse
import dataclasses
import sys
from collections.abc import Sequence

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.commands.lib.arm_command import (
    add_arm_arguments,
    ask,
    need_terminal,
    run_command,
    tell,
    with_likely_gripper,
)
from lerobot_robot_yam.doctor.kit.targets import LEADER_GRIPPER, from_config
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.paths import user_path

_WORD = "drive"


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `yam-view`; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="yam-view", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default 127.0.0.1: this computer)")
    parser.add_argument("--port", type=int, default=8080, help="port, or the next free one (default 8080)")
    parser.add_argument("--token", action="store_true", help="ask for a token on this computer, too")
    parser.add_argument("--desktop", action="store_true", help="a window of MuJoCo's viewer; no browser, no server")
    parser.add_argument(
        "--config_path", type=user_path, metavar="PATH", help="LeRobot run config with the arms to drive"
    )
    add_arm_arguments(parser, required=False)
    parser.add_argument("--calibration", metavar="PATH", help="the gripper's stored stops; else it seeks its stops")
    parser.add_argument("--yes", action="store_true", help="do not ask before an arm is energised")
    args = parser.parse_args(arguments)
    return run_command("yam-view", lambda: _view(args))


def _view(args: argparse.Namespace) -> int:
    try:
        import viser  # noqa: F401  --help does without
    except ImportError as error:
        raise ConfigError(f'yam-view needs viser: pip install "lerobot_robot_yam[view]" ({error})') from error
    if args.desktop:
        return _desktop(args)
    from lerobot_robot_yam.viewer.live.live import Live
    from lerobot_robot_yam.viewer.serving.page import Page, served

    page = Page(args.host, args.port, args.token)
    parts = [Live(page.server)]
    with served(page, parts):
        tell(f"open {page.url} in a browser; Ctrl-C ends the page, sessions go on")
        page.run(parts)
    return 0


def _desktop(args: argparse.Namespace) -> int:
    from lerobot_robot_yam.session.arm_session import ArmSession
    from lerobot_robot_yam.viewer.desktop.desktop import need_display, run_desktop
    from lerobot_robot_yam.viewer.desktop.drag_control import DragControl

    need_display()
    if args.channel is None and args.config_path is None:
        run_desktop()
        return 0
    need_terminal(args.yes)
    configs = driven(args)
    channels = " and ".join(config.channel for config in configs)
    tell(
        f"HAZARD: this energises the arms on {channels}. They hold; after SPACE their tools go where you drag them. Keep "
        "clear of their way, and the emergency stop within reach. A gripper may close and open to find its stops."
    )
    if not args.yes and ask(f"Type {_WORD} to go on:") != _WORD:
        raise ConfigError("not confirmed; nothing was energised")
    session = ArmSession(configs)
    try:
        session.start()
        run_desktop(DragControl(session, [config.name for config in configs]))
    finally:
        session.stop()
    tell("the arms have landed")
    return 0


def driven(args: argparse.Namespace) -> list[ArmConfig]:
    """The arms that the arguments name: one by its channel, or the followers of a run config.

    Raises:
        ConfigError: the config cannot be used, or has no followers.
        BusError: the channel cannot be opened.
    """
    if args.config_path is None:
        return [with_likely_gripper(args, calibration_path=args.calibration)]
    targets = from_config(args.config_path, args.rig).targets
    followers = [target for target in targets if target.config.gripper != LEADER_GRIPPER]
    if not followers:
        raise ConfigError(f"{args.config_path} has no follower")
    return [dataclasses.replace(target.config, calibration_path=str(target.calibration)) for target in followers]


if __name__ == "__main__":
    sys.exit(main())
