"""Options `--host` and `--key` of commands that can also work on the arms of another computer."""

import argparse
import sys

from lerobot_robot_yam.errors import YamError

_TOOL_S = 150.0  # timeout for a tool on the host, s: above the host's own timeout of 120 s


def add_host_arguments(parser: argparse.ArgumentParser, name: str = "--host") -> None:
    """Add the options; `name` replaces --host in commands where --host has another meaning."""
    parser.add_argument(
        name, dest="arms_host", metavar="ADDRESS", help="the arms are of the computer where this yam-host runs"
    )
    parser.add_argument("--key", metavar="FILE", help=f"with {name}: this computer's key file (yam-host pair)")


def ask_host(args: argparse.Namespace, op: str, within_s: float = 2.0, **fields: object) -> dict:
    """Send a request to the host named by the arguments; return the reply.

    Raises:
        YamError: the host does not reply, or refuses the request.
    """
    from lerobot_robot_yam.remote.host_address import HostAddress
    from lerobot_robot_yam.remote.host_question import Host  # imported late: needs pyzmq

    return Host(HostAddress.of(args.arms_host), args.key).ask(op, within_s, **fields)


def run_tool(program: str, args: argparse.Namespace, **fields: object) -> int:
    """Run the same command on the host, print its output, and return its exit status.

    The exit status is 2 if the host does not reply, or refuses the request.
    """
    try:
        done = ask_host(args, "tool", _TOOL_S, json=args.json, **fields)
    except YamError as error:
        sys.stderr.write(f"{program}: {error}\n")
        return 2
    sys.stderr.write(str(done["err"]))
    sys.stdout.write(str(done["out"]))
    return int(done["status"])
