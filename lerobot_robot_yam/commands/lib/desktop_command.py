"""`yam-view --desktop`: which arms it drives, the question before they are energised, and their landing."""

import argparse

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.commands.lib.arm_command import (
    add_arm_arguments,
    ask,
    need_terminal,
    tell,
    tell_landed,
    with_likely_gripper,
)
from lerobot_robot_yam.doctor.kit.targets import from_config
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.paths import user_path

_WORD = "drive"


def add_desktop_arguments(parser: argparse.ArgumentParser) -> None:
    """The window, and the arms that it drives."""
    parser.add_argument("--desktop", action="store_true", help="a window of MuJoCo's viewer; no browser, no server")
    parser.add_argument("--config_path", type=user_path, metavar="PATH", help="run config whose followers to drive")
    add_arm_arguments(parser, required=False)
    parser.add_argument("--calibration", metavar="PATH", help="the gripper's stored stops; else it seeks its stops")
    parser.add_argument("--yes", action="store_true", help="do not ask before an arm is energised")


def run_desktop_command(args: argparse.Namespace) -> int:
    """Show the window; returns the exit status.

    Raises:
        ConfigError: there is no screen, or nobody confirmed.
        YamError: the arms cannot be driven.
    """
    from lerobot_robot_yam.session.arm_session import ArmSession
    from lerobot_robot_yam.viewer.desktop.desktop import (
        need_display,
        run_desktop,
    )  # MuJoCo's viewer: --help does without
    from lerobot_robot_yam.viewer.desktop.drag_control import DragControl

    need_display()
    if args.channel is None and args.config_path is None:
        run_desktop()
        return 0
    need_terminal(args.yes)
    configs = driven(args)
    channels = " and ".join(config.channel for config in configs)
    tell(
        f"HAZARD: this energises the arms on {channels}. They hold; after SPACE their tools go where you drag them. "
        "Keep clear of their way, and the emergency stop within reach. Grippers may close and open to find their stops."
    )
    if not args.yes and ask(f"Type {_WORD} to go on:") != _WORD:
        raise ConfigError("not confirmed; nothing was energised")
    session = ArmSession(configs)
    try:
        session.start()
        run_desktop(DragControl(session, [config.name for config in configs]))
    finally:
        landed = session.stop()
    return tell_landed(landed)


def driven(args: argparse.Namespace) -> list[ArmConfig]:
    """The arms that the arguments name: one by its channel, or the followers of a run config.

    Raises:
        ConfigError: the config cannot be used, or has no followers.
        BusError: the channel cannot be opened.
    """
    if args.config_path is None:
        return [with_likely_gripper(args, calibration_path=args.calibration)]
    followers = from_config(args.config_path, args.rig).followers
    if not followers:
        raise ConfigError(f"{args.config_path} has no follower")
    return [target.driven for target in followers]
