"""The options `--host` and `--key` of commands that also work on the arms of another computer."""

import argparse
import sys

from lerobot_robot_yam.errors import YamError

_TOOL_S = 150.0  # wait for a tool on the host, s: the host ends its tools after 120 s


def add_host_arguments(parser: argparse.ArgumentParser, name: str = "--host") -> None:
    """Add the options; `name` replaces --host in a command where --host means something else."""
    parser.add_argument(
        name, dest="arms_host", metavar="ADDRESS", help="the arms are of the computer where this yam-host runs"
    )
    parser.add_argument("--key", metavar="FILE", help=f"with {name}: this computer's key file (yam-host pair)")


def ask_host(args: argparse.Namespace, op: str, within_s: float = 2.0, **fields: object) -> dict:
    """Send a question to the host that the arguments name; return the answer.

    Raises:
        YamError: the host does not answer, or refuses.
    """
    from lerobot_robot_yam.remote.host_address import HostAddress
    from lerobot_robot_yam.remote.host_question import Host  # late: needs pyzmq

    return Host(HostAddress.of(args.arms_host), args.key).ask(op, within_s, **fields)


def run_tool(program: str, args: argparse.Namespace, **fields: object) -> int:
    """Have the host run the same command, print the output, and return its exit status.

    The exit status is 2 if the host does not answer, or refuses.
    """
    try:
        done = ask_host(args, "tool", _TOOL_S, json=args.json, **fields)
    except YamError as error:
        sys.stderr.write(f"{program}: {error}\n")
        return 2
    sys.stderr.write(str(done["err"]))
    sys.stdout.write(str(done["out"]))
    return int(done["status"])
