"""Show the arms that run on this computer in a browser: where they are, what they are doing, what is wrong.

yam-view                    watch every session; it can neither slow nor stop one
yam-view --host 0.0.0.0     for browsers of other computers, too, which need the token in the address that it prints

The page has an emergency stop. Ctrl-C ends the page; sessions go on.
"""

import argparse
import sys
from collections.abc import Sequence

from lerobot_robot_yam.commands.lib.arm_command import run_command, tell


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `yam-view`; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="yam-view", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default 127.0.0.1: this computer)")
    parser.add_argument("--port", type=int, default=8080, help="port, or the next free one (default 8080)")
    args = parser.parse_args(arguments)
    return run_command("yam-view", lambda: _view(args))


def _view(args: argparse.Namespace) -> int:
    from lerobot_robot_yam.viewer.desk.session_desks import SessionDesks
    from lerobot_robot_yam.viewer.live.live import Live
    from lerobot_robot_yam.viewer.serving.page import Page, Part, served  # viser: --help does without

    page = Page(args.host, args.port)
    parts: list[Part] = [Live(page.server), SessionDesks(page.server)]
    with served(page, parts):
        tell(f"open {page.url} in a browser; Ctrl-C ends the page, sessions go on")
        page.run(parts)
    return 0


if __name__ == "__main__":
    sys.exit(main())
