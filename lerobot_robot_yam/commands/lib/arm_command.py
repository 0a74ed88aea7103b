"""Shared by the commands about one arm: arguments, the exclusive channel, questions, exit status."""

import argparse
import logging
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import can

from lerobot_robot_yam.arm.config import SOCKETCAN, VIRTUAL, ArmConfig
from lerobot_robot_yam.arm.profile_files import ARMS, GRIPPERS
from lerobot_robot_yam.control.preflight.open_bus import open_bus
from lerobot_robot_yam.damiao.motor_inspection import LISTEN_S, listen
from lerobot_robot_yam.damiao.motor_spec import MOTOR_IDS
from lerobot_robot_yam.errors import ConfigError, YamError
from lerobot_robot_yam.state.records import channel_key, lock_path
from lerobot_robot_yam.system.runtime_files import FileLock, rig_name

_INTERRUPTED = 130  # the shell's own status after Ctrl-C


def add_arm_arguments(parser: argparse.ArgumentParser) -> None:
    """Which arm: channel, interface, hardware."""
    parser.add_argument("--channel", required=True, help="CAN channel, such as can_follower_l")
    parser.add_argument("--interface", help="python-can interface (default socketcan, with --rig yam_sim)")
    parser.add_argument("--rig", help="name of a virtual rig")
    parser.add_argument("--arm", default="yam", help=f"profile of the arm (default yam; {', '.join(ARMS)})")
    parser.add_argument("--gripper", help=f"profile of the gripper (default: what answers; {', '.join(GRIPPERS)})")
    parser.add_argument("--name", help="what the arm is called (default: its channel)")


def seconds(text: str) -> float:
    """A time on the command line. Raises argparse.ArgumentTypeError: none that passes."""
    found = float(text)
    if not 0.0 < found < math.inf:  # not a number, too
        raise argparse.ArgumentTypeError(f"give a number of seconds above 0, not {text}")
    return found


def arm_config(args: argparse.Namespace, **fields: Any) -> ArmConfig:
    """Configuration of the arm that the arguments describe, and `fields` where the arguments say nothing."""
    interface = args.interface or (VIRTUAL if args.rig else SOCKETCAN)
    if args.gripper is not None:
        fields["gripper"] = args.gripper
    return ArmConfig(
        name=args.name or args.channel,
        channel=args.channel,
        interface=interface,
        can_options={"rig": rig_name(args.rig)[0]} if interface == VIRTUAL else {},
        arm=args.arm,
        **fields,
    )


@contextmanager
def own_bus(config: ArmConfig) -> Iterator[can.BusABC]:
    """The arm's open channel, while nobody else drives it.

    Raises:
        ChannelInUseError: another process of ours, or another driver on the wire, does.
        BusError: it cannot be opened.
    """
    lock = FileLock(
        lock_path(channel_key(config.interface, config.channel, config.can_options.get("rig"))),
        f"CAN channel {config.channel}",
    )
    lock.acquire()
    try:
        bus = open_bus(config)
        try:
            listen(bus, LISTEN_S, MOTOR_IDS, config.channel)
            yield bus
        finally:
            bus.shutdown()
    finally:
        lock.release()


def need_terminal(yes: bool) -> None:
    """Refuse, before anything was done, to go on without anybody to ask.

    Raises:
        ConfigError: standard input is no terminal, and --yes was not given.
    """
    if not yes and not sys.stdin.isatty():
        raise ConfigError("there is no terminal to confirm at; run it in one, or give --yes")


def ask(question: str) -> str:
    """One line from the terminal, asked on standard error so that standard output stays clean.

    Raises:
        ConfigError: the terminal has gone.
    """
    tell(question, end=" ")
    line = sys.stdin.readline()
    if not line:
        raise ConfigError("the terminal gave no answer; nothing more was done")
    return line.strip()


def tell(text: str, end: str = "\n") -> None:
    """Words for the person at the terminal."""
    sys.stderr.write(text + end)
    sys.stderr.flush()


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Columns, right-aligned except the first."""
    lines = [head, *rows]
    widths = [max(len(line[i]) for line in lines) for i in range(len(head))]
    return "\n".join(
        "  ".join(c.ljust(w) if i == 0 else c.rjust(w) for i, (c, w) in enumerate(zip(line, widths, strict=True)))
        for line in lines
    )


def run_command(program: str, work: Callable[[], int]) -> int:
    """Do the work of a command; errors of ours become one line and status 1."""
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(message)s")
    try:
        return work()
    except YamError as error:
        tell(f"{program}: {error}")
        return 1
    except KeyboardInterrupt:
        tell(f"{program}: interrupted")
        return _INTERRUPTED
