"""Shared by the commands about one arm: arguments, the exclusive channel, questions, exit status."""

import argparse
import logging
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import can

from lerobot_robot_yam.arm.config import ARMS, GRIPPERS, SOCKETCAN, VIRTUAL, ArmConfig
from lerobot_robot_yam.arm.mounting import gripper_id
from lerobot_robot_yam.arm.profile_files import load_arm
from lerobot_robot_yam.control.preflight.open_bus import open_bus
from lerobot_robot_yam.control.preflight.role import answering_gripper
from lerobot_robot_yam.damiao.motor_inspection import LISTEN_S, listen
from lerobot_robot_yam.damiao.motor_spec import MOTOR_IDS
from lerobot_robot_yam.errors import ConfigError, YamError
from lerobot_robot_yam.state.records import channel_key, lock_path
from lerobot_robot_yam.system.runtime_files import FileLock, rig_name

CLEAR_SCREEN = "\x1b[H\x1b[J"
_INTERRUPTED = 130  # the shell's own status after Ctrl-C
_PER_ARM = ("channel", "arm", "gripper", "name", "calibration")


def command_parser(program: str, text: str | None) -> argparse.ArgumentParser:
    """Return the parser of a command whose help is `text`, line by line."""
    return argparse.ArgumentParser(prog=program, description=text, formatter_class=argparse.RawDescriptionHelpFormatter)


def add_arm_arguments(parser: argparse.ArgumentParser, several: bool = False, required: bool = True) -> None:
    """Add which arm: channel, interface, hardware. `several`: one or two; `each_arm` tells them apart."""
    more: dict[str, Any] = {"nargs": "+"} if several else {}
    parser.add_argument("--channel", required=required, **more, help="CAN channel, such as can_follower_l")
    parser.add_argument("--interface", help="python-can interface (default socketcan, with --rig yam_sim)")
    parser.add_argument("--rig", help="name of a virtual rig")
    arm = ["yam"] if several else "yam"
    parser.add_argument("--arm", default=arm, **more, help=f"profile of the arm (default yam; {', '.join(ARMS)})")
    grippers = ", ".join(GRIPPERS)
    parser.add_argument("--gripper", **more, help=f"profile of the gripper (default: what answers; {grippers})")
    parser.add_argument("--name", **more, help="what the arm is called (default: its channel)")


def each_arm(args: argparse.Namespace) -> list[argparse.Namespace]:
    """Return the arguments of each arm, of a command that takes several; one profile may stand for all.

    Raises:
        ConfigError: more than two arms, or a number of values that fits neither.
    """
    count = len(args.channel)
    if count > 2:
        raise ConfigError(f"--channel takes one or two channels, not {count}")
    arms = [argparse.Namespace(**vars(args)) for _ in range(count)]
    for option in _PER_ARM:
        values = getattr(args, option, None)
        if values is not None and len(values) not in (1, count):
            raise ConfigError(f"--{option} takes one value for each of {', '.join(args.channel)}, not {len(values)}")
        for index, arm in enumerate(arms):
            setattr(arm, option, None if values is None else values[index if len(values) > 1 else 0])
    return arms


def seconds(text: str) -> float:
    """Parse a time on the command line. Raises argparse.ArgumentTypeError: none that passes."""
    found = float(text)
    if not 0.0 < found < math.inf:  # not a number, too
        raise argparse.ArgumentTypeError(f"give a number of seconds above 0, not {text}")
    return found


def arm_config(args: argparse.Namespace, **fields: Any) -> ArmConfig:
    """Return the config of the arm that the arguments describe, with `fields` where the arguments say nothing."""
    interface = args.interface or (VIRTUAL if args.rig else SOCKETCAN)
    if args.gripper is not None:
        fields["gripper"] = args.gripper
    return ArmConfig(
        name=args.name or args.channel,
        channel=args.channel,
        interface=interface,
        can_options={"rig": rig_name(args.rig)[0]} if interface == VIRTUAL or args.rig else {},
        arm=args.arm,
        **fields,
    )


def with_answering_gripper(args: argparse.Namespace, bus: can.BusABC, **fields: Any) -> ArmConfig:
    """As `arm_config`, with the gripper that answers on the open bus, unless one was given.

    Raises:
        BusError: the channel is gone.
    """
    if args.gripper is not None:
        return arm_config(args, **fields)
    return arm_config(args, **fields, gripper=answering_gripper(bus, args.channel, gripper_id(load_arm(args.arm))))


def with_likely_gripper(args: argparse.Namespace, **fields: Any) -> ArmConfig:
    """As `arm_config`, with the gripper that answers, unless one was given; say which. Energises nothing.

    Raises:
        BusError: the channel cannot be opened, or another program drives the arm.
    """
    config = arm_config(args, **fields)
    if args.gripper is None:
        with own_bus(config) as bus:
            config = with_answering_gripper(args, bus, **fields)
        tell(f"{config.name}: taking the gripper to be {config.gripper} (else give --gripper)")
    return config


@contextmanager
def own_bus(config: ArmConfig) -> Iterator[can.BusABC]:
    """Open the arm's channel, while nobody else drives it.

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
    """Read one line from the terminal; the question goes to standard error, so that standard output stays clean.

    Raises:
        ConfigError: the terminal has gone.
    """
    tell(question, end=" ")
    line = sys.stdin.readline()
    if not line:
        raise ConfigError("the terminal gave no answer; nothing more was done")
    return line.strip()


def agreed(question: str) -> bool:
    """Whether the person at the terminal says yes, or just Enter. Raises ConfigError: the terminal has gone."""
    return ask(f"{question} [Y/n]").lower() in ("", "y", "yes")


def confirm_word(word: str, question: str, left: str = "nothing was energised") -> None:
    """Go on only if the person types the word. Raises ConfigError: another word; the message says what was left."""
    if ask(question) != word:
        raise ConfigError(f"not confirmed; {left}")


def tell(text: str, end: str = "\n") -> None:
    """Show words to the person at the terminal."""
    sys.stderr.write(text + end)
    sys.stderr.flush()


def tell_landed(landed: bool) -> int:
    """Say whether the arms are down, which `ArmSession.stop` returns; returns the exit status."""
    from lerobot_robot_yam.session.arm_session import still_in_the_air  # loaded already by whoever has landed

    tell("the arms have landed" if landed else still_in_the_air("THE ARMS ARE"))
    return 0 if landed else 1


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return columns, right-aligned except the first."""
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
