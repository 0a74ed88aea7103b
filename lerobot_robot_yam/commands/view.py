"""Show the arms that run on this computer in a browser: where they are, what they are doing, what is wrong.

yam-view                           watch every session; it can neither slow nor stop one
yam-view --host 0.0.0.0            for browsers of other computers, too, which need the token in the address it prints
yam-view --config_path=rig.yaml    drive the followers of a rig's file or run config from the page, too
yam-view --channel can_follower_l  drive one arm

The page has an emergency stop. Ctrl-C ends the page; other sessions go on.
HAZARD: with --config_path or --channel a person at the page can ENERGISE the arms. However the page ends, they land.
"""

import argparse
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from lerobot_robot_yam.commands.lib.arm_command import add_arm_arguments, run_command, tell, with_likely_gripper
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.paths import user_path

if TYPE_CHECKING:
    from lerobot_robot_yam.viewer.moving.driving_plan import DrivingPlan


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `yam-view`; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="yam-view", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default 127.0.0.1: this computer)")
    parser.add_argument("--port", type=int, default=8080, help="port, or the next free one (default 8080)")
    parser.add_argument("--config_path", type=user_path, metavar="FILE", help="a rig's file or run config, to drive it")
    add_arm_arguments(parser, required=False)
    parser.add_argument("--calibration", metavar="PATH", help="with --channel: the gripper's stored stops")
    args = parser.parse_args(arguments)
    return run_command("yam-view", lambda: _view(args))


def _view(args: argparse.Namespace) -> int:
    from lerobot_robot_yam.viewer.live.live import Live
    from lerobot_robot_yam.viewer.moving.moving import Moving
    from lerobot_robot_yam.viewer.serving.page import Page, Part, served  # viser: --help does without

    plan = _plan(args)
    page = Page(args.host, args.port)
    live = Live(page.server)
    parts: list[Part] = [live]
    with served(page, parts):
        if plan is not None:
            parts.append(moving := Moving(page.server, plan, live.place_of))
            moving.driver.start()
        ends = "ends the page" if plan is None else "ends the page and lands its arms"
        tell(f"open {page.url} in a browser; Ctrl-C {ends}, other sessions go on")
        page.run(parts)
    return 0


def _plan(args: argparse.Namespace) -> "DrivingPlan | None":
    """The arms to drive; None: none."""
    from lerobot_robot_yam.viewer.moving.driving_plan import plan_of_arm, plan_of_file

    if args.config_path is not None and args.channel is not None:
        raise ConfigError("give --config_path or --channel, not both")
    if args.config_path is not None:
        return plan_of_file(args.config_path, args.rig)
    if args.channel is not None:
        return plan_of_arm(with_likely_gripper(args, calibration_path=args.calibration))
    return None


if __name__ == "__main__":
    sys.exit(main())
