"""Show the arms that run on this computer in a browser: where they are, what they are doing, what is wrong.

yam-view                    watch every session; it can neither slow nor stop one
yam-view --host 0.0.0.0     for browsers of other computers, too, which need the token in the address that it prints
yam-view --dataset data/NAME                              a LeRobot data set: check it, play it in 3-D
yam-view --dataset data/NAME --config_path=replay.yaml    and send its episodes to the arms of a run config

The page has an emergency stop. Ctrl-C ends the page; sessions go on.
"""

import argparse
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from lerobot_robot_yam.commands.lib.arm_command import run_command, tell
from lerobot_robot_yam.system.paths import user_path

if TYPE_CHECKING:
    from lerobot_robot_yam.viewer.serving.page import Page, Part


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `yam-view`; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="yam-view", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default 127.0.0.1: this computer)")
    parser.add_argument("--port", type=int, default=8080, help="port, or the next free one (default 8080)")
    parser.add_argument("--dataset", metavar="PATH_OR_REPO_ID", help="LeRobot data set to look at")
    parser.add_argument("--arm", default="yam", help="profile of its arms, where no config tells (default yam)")
    parser.add_argument("--gripper", default="linear_4310", help="profile of their grippers (default linear_4310)")
    parser.add_argument("--config_path", type=user_path, help="run config with arms and cameras")
    args = parser.parse_args(arguments)
    return run_command("yam-view", lambda: _view(args))


def _view(args: argparse.Namespace) -> int:
    from lerobot_robot_yam.viewer.live.live import Live
    from lerobot_robot_yam.viewer.serving.page import Page, Part, served  # viser: --help does without

    page = Page(args.host, args.port)
    parts: list[Part] = [Live(page.server)]
    if args.dataset is not None:
        parts.append(_data(page, args))
    with served(page, parts):
        tell(f"open {page.url} in a browser; Ctrl-C ends the page, sessions go on")
        page.run(parts)
    return 0


def _data(page: "Page", args: argparse.Namespace) -> "Part":
    from lerobot_robot_yam.doctor.kit.targets import Plan, from_config
    from lerobot_robot_yam.face.datasets.located import locate
    from lerobot_robot_yam.viewer.data.data_part import DataPart
    from lerobot_robot_yam.viewer.data.recorded_arms import followers
    from lerobot_robot_yam.viewer.data.session_driver import SessionDriver

    plan = Plan() if args.config_path is None else from_config(args.config_path, None)
    known = followers(plan.targets)
    return DataPart(
        page.server,
        locate(args.dataset),
        known=known,
        cameras=plan.cameras,
        arm=args.arm,
        gripper=args.gripper,
        driver=SessionDriver(known) if known else None,
    )


if __name__ == "__main__":
    sys.exit(main())
