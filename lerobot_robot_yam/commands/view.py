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
import sys
from collections.abc import Sequence

from lerobot_robot_yam.commands.lib.arm_command import run_command, tell
from lerobot_robot_yam.commands.lib.desktop_command import add_desktop_arguments, run_desktop_command
from lerobot_robot_yam.errors import ConfigError


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `yam-view`; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="yam-view", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default 127.0.0.1: this computer)")
    parser.add_argument("--port", type=int, default=8080, help="port, or the next free one (default 8080)")
    parser.add_argument("--token", action="store_true", help="ask for a token on this computer, too")
    add_desktop_arguments(parser)
    args = parser.parse_args(arguments)
    return run_command("yam-view", lambda: _view(args))


def _view(args: argparse.Namespace) -> int:
    try:
        import viser  # noqa: F401  --help does without
    except ImportError as error:
        raise ConfigError(f'yam-view needs viser: pip install "lerobot_robot_yam[view]" ({error})') from error
    if args.desktop:
        return run_desktop_command(args)
    if args.channel is not None or args.config_path is not None:
        raise ConfigError("--channel and --config_path need --desktop: the page itself drives no arm")
    from lerobot_robot_yam.viewer.live.live import Live
    from lerobot_robot_yam.viewer.serving.page import Page, served

    page = Page(args.host, args.port, args.token)
    parts = [Live(page.server)]
    with served(page, parts):
        tell(f"open {page.url} in a browser; Ctrl-C ends the page, sessions go on")
        page.run(parts)
    return 0


if __name__ == "__main__":
    sys.exit(main())
