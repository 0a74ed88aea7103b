"""Show the arms that run on this computer in a browser: their poses, activities and faults.

yam-view                           watch every session; label a LeRobot command's episodes, or end it
yam-view --config_path=rig.yaml    drive the followers of a rig's file or run config from the page, too
yam-view --channel can_follower_l  drive one arm
yam-view --dataset data/NAME       a LeRobot data set: check it, play it in 3-D; with --config_path send it to the arms
yam-view --host 0.0.0.0            for browsers of other computers, too, which need the token in the address it prints
yam-view --token                   ask for a token on this computer, too, where other people have accounts
yam-view --remote 192.168.1.20     also the arms of another computer, where yam-host runs (docs/two-machines.md)
yam-view --desktop                 MuJoCo's own viewer instead of a browser; it drives arms as above, by the mouse

The page has an emergency stop, and buttons that end a LeRobot command. Ctrl-C ends the page; other sessions go on.

HAZARD: with --config_path or --channel a person at the page can ENERGISE the arms. The arms land however the page ends.
"""

import argparse
import contextlib
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from lerobot_robot_yam.commands.lib.arm_command import add_arm_arguments, with_likely_gripper
from lerobot_robot_yam.commands.lib.command_line import command_parser, run_command
from lerobot_robot_yam.commands.lib.dialogue import confirm_word, need_terminal, tell, tell_landed
from lerobot_robot_yam.commands.lib.host_option import add_host_arguments
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.own_commands import install_extra
from lerobot_robot_yam.system.paths import user_path

if TYPE_CHECKING:
    from lerobot_robot_yam.viewer.moving.driver import Driver
    from lerobot_robot_yam.viewer.moving.driving_plan import DrivingPlan
    from lerobot_robot_yam.viewer.serving.page import Page, Part

_WORD = "drive"  # word that the user types before `--desktop` energises arms


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `yam-view`; return its exit status."""
    parser = command_parser("yam-view", __doc__)
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default 127.0.0.1: this computer)")
    parser.add_argument("--port", type=int, default=8080, help="port, or the next free one (default 8080)")
    parser.add_argument("--token", action="store_true", help="ask for a token on this computer, too")
    parser.add_argument("--dataset", metavar="PATH_OR_REPO_ID", help="LeRobot data set to look at")
    parser.add_argument("--desktop", action="store_true", help="a window of MuJoCo's viewer; no browser, no server")
    parser.add_argument("--config_path", type=user_path, metavar="PATH", help="run config whose followers to drive")
    add_arm_arguments(parser, required=False)
    parser.add_argument("--calibration", metavar="PATH", help="the gripper's stored stops; else it seeks its stops")
    parser.add_argument("--yes", action="store_true", help="do not ask before an arm is energised")
    add_host_arguments(parser, "--remote")
    args = parser.parse_args(arguments)
    return run_command("yam-view", lambda: _view(args))


def _view(args: argparse.Namespace) -> int:
    try:
        import viser  # noqa: F401  imported late: --help must work without viser
    except ImportError as error:
        raise ConfigError(f"yam-view needs viser ({error}); {install_extra('view')}") from error
    if args.config_path is not None and args.channel is not None:
        raise ConfigError("give --config_path or --channel, not both")
    if args.desktop:
        if args.dataset is not None:
            raise ConfigError("the window shows no data set: leave out --desktop or --dataset")
        with _watched(args):
            return _desktop(args)
    from lerobot_robot_yam.viewer.live.live import Live
    from lerobot_robot_yam.viewer.serving.page import Page, Part, served
    from lerobot_robot_yam.viewer.session_desks import SessionDesks

    if args.dataset is not None and args.channel is not None:
        raise ConfigError("a data set is sent to the arms of a config: give --config_path, not --channel")
    plan = driving_plan(args)
    page = Page(args.host, args.port, args.token)
    live = Live(page.server, page.troubles)
    parts: list[Part] = [live, SessionDesks(page.server)]
    with _watched(args), served(page, parts):
        driver = None
        if plan is not None:
            from lerobot_robot_yam.viewer.moving.moving import Moving

            moving = Moving(page.server, plan, live.place_of)
            driver = moving.driver
            parts.append(moving)
        if args.dataset is not None:
            # Parts are closed in reverse order: a video or a camera must not delay the landing of the arms.
            parts.insert(0, _data(page, args, driver))
        if driver is not None:
            driver.start()
        ends = "ends the page" if driver is None else "ends the page and lands its arms"
        tell(f"open {page.url} in a browser; Ctrl-C {ends}, other sessions go on")
        page.run(parts)
    return 0


def _desktop(args: argparse.Namespace) -> int:
    """Show the window of `--desktop`; return the exit status.

    Raises:
        ConfigError: there is no display, or the user did not confirm.
        YamError: the arms cannot be driven.
    """
    from lerobot_robot_yam.session.arm_session import ArmSession  # imported late: loads MuJoCo and its viewer
    from lerobot_robot_yam.viewer.desktop_window import DragControl, need_display, run_desktop

    need_display()
    if args.channel is not None or args.config_path is not None:
        need_terminal(args.yes)
    plan = driving_plan(args)
    if plan is None:
        run_desktop()
        return 0
    if plan.base is not None:
        raise ConfigError("the window drives no base: leave out --desktop, and drive it from the page")
    channels = " and ".join(config.channel for config in plan.configs)
    tell(
        f"HAZARD: this energises the arms on {channels}. They hold; after SPACE their tools go where you drag them. "
        "Keep clear of their way, and the emergency stop within reach. Grippers may close and open to find their stops."
    )
    for note in plan.notes:
        tell(note)
    confirm_word(args.yes, _WORD, f"Type {_WORD} to go on:")
    session = ArmSession(plan.configs)
    try:
        session.start()
        run_desktop(DragControl(session, [config.name for config in plan.configs]))
    finally:
        landed = session.stop()
    return tell_landed(landed)


def driving_plan(args: argparse.Namespace) -> "DrivingPlan | None":
    """Return the plan for the arms that the arguments name by channel or config, or None if they name no arm.

    Raises:
        ConfigError: the config is not valid.
        BusError: the channel cannot be opened.
    """
    from lerobot_robot_yam.viewer.moving.driving_plan import plan_of_arm, plan_of_file

    if args.config_path is not None:
        return plan_of_file(args.config_path, args.rig)
    if args.channel is not None:
        return plan_of_arm(with_likely_gripper(args, calibration_path=args.calibration))
    return None


def _watched(args: argparse.Namespace) -> contextlib.AbstractContextManager[None]:
    """Return a context manager that shows the arms of `--remote` on this computer."""
    if args.arms_host is None:
        return contextlib.nullcontext()
    from lerobot_robot_yam.remote.host_address import HostAddress
    from lerobot_robot_yam.remote.host_question import Host
    from lerobot_robot_yam.remote.host_watch import watched

    return watched(Host(HostAddress.of(args.arms_host), args.key))


def _data(page: "Page", args: argparse.Namespace, driver: "Driver | None") -> "Part":
    from lerobot_robot_yam.doctor.kit.targets import Plan, from_config
    from lerobot_robot_yam.face.datasets.layout import locate
    from lerobot_robot_yam.viewer.data.data_part import DataPart
    from lerobot_robot_yam.viewer.data.recorded_arms import GRIPPER, followers

    plan = Plan() if args.config_path is None else from_config(args.config_path, args.rig)
    known = followers(plan)
    return DataPart(
        page.server,
        locate(args.dataset),
        known=known,
        cameras=plan.cameras,
        arm=args.arm,
        gripper=args.gripper or GRIPPER,
        driver=driver if known else None,
    )


if __name__ == "__main__":
    sys.exit(main())
