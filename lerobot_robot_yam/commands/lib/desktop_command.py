"""`yam-view --desktop`: which arms it drives, the question before they are energised, and their landing."""

import argparse
from typing import TYPE_CHECKING

from lerobot_robot_yam.commands.lib.arm_command import (
    add_arm_arguments,
    ask,
    need_terminal,
    tell,
    tell_landed,
    with_likely_gripper,
)
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.paths import user_path

if TYPE_CHECKING:
    from lerobot_robot_yam.viewer.moving.driving_plan import DrivingPlan

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
    if args.channel is not None or args.config_path is not None:
        need_terminal(args.yes)
    plan = driving_plan(args)
    if plan is None:
        run_desktop()
        return 0
    channels = " and ".join(config.channel for config in plan.configs)
    tell(
        f"HAZARD: this energises the arms on {channels}. They hold; after SPACE their tools go where you drag them. "
        "Keep clear of their way, and the emergency stop within reach. Grippers may close and open to find their stops."
    )
    for note in plan.notes:
        tell(note)
    if not args.yes and ask(f"Type {_WORD} to go on:") != _WORD:
        raise ConfigError("not confirmed; nothing was energised")
    session = ArmSession(plan.configs)
    try:
        session.start()
        run_desktop(DragControl(session, [config.name for config in plan.configs]))
    finally:
        landed = session.stop()
    return tell_landed(landed)


def driving_plan(args: argparse.Namespace) -> "DrivingPlan | None":
    """The arms that the arguments name: one by its channel, or those of a config; None: none.

    Raises:
        ConfigError: the config cannot be used.
        BusError: the channel cannot be opened.
    """
    from lerobot_robot_yam.viewer.moving.driving_plan import plan_of_arm, plan_of_file

    if args.config_path is not None:
        return plan_of_file(args.config_path, args.rig)
    if args.channel is not None:
        return plan_of_arm(with_likely_gripper(args, calibration_path=args.calibration))
    return None
