"""Functions shared by arm commands: options, config, and exclusive access to the channel."""

import argparse
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any

import can

from lerobot_robot_yam.arm.config import ARMS, GRIPPERS, SOCKETCAN, VIRTUAL, ArmConfig, ChannelConfig
from lerobot_robot_yam.arm.mounting import gripper_id
from lerobot_robot_yam.arm.profile_files import load_arm
from lerobot_robot_yam.commands.lib.dialogue import tell
from lerobot_robot_yam.control.preflight.open_bus import open_bus
from lerobot_robot_yam.control.preflight.role import answering_gripper
from lerobot_robot_yam.damiao.motor_inspection import LISTEN_S, listen
from lerobot_robot_yam.damiao.motor_spec import MOTOR_IDS
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.mobile.base_config import BASE, BaseConfig
from lerobot_robot_yam.state.records import channel_key, lock_path
from lerobot_robot_yam.system.runtime_files import FileLock, rig_name

_PER_ARM = ("channel", "arm", "gripper", "name", "calibration", "tuning")


def add_arm_arguments(
    parser: argparse.ArgumentParser, several: bool = False, required: bool = True, base: bool = False
) -> None:
    """Add the options that select an arm: channel, interface, hardware. `several`: one or two arms, see `each_arm`.

    base: whether the command also works on a mobile base, see `part_config`.
    """
    more: dict[str, Any] = {"nargs": "+"} if several else {}
    parser.add_argument("--channel", required=required, **more, help="CAN channel, such as can_follower_l")
    add_place_arguments(parser)
    arm, arms = ["yam"] if several else "yam", ", ".join([*ARMS, *([f"{BASE} for a mobile base"] if base else [])])
    parser.add_argument("--arm", default=arm, **more, help=f"profile of the arm (default yam; {arms})")
    grippers = ", ".join(GRIPPERS)
    parser.add_argument("--gripper", **more, help=f"profile of the gripper (default: what answers; {grippers})")
    parser.add_argument("--name", **more, help="what the arm is called (default: its channel)")


def add_place_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options for the CAN interface and the virtual rig; `place_of` evaluates them."""
    parser.add_argument("--interface", help=f"python-can interface (default {SOCKETCAN}, with --rig {VIRTUAL})")
    parser.add_argument("--rig", help="name of a virtual rig")


def place_of(interface: str | None, rig: str | None) -> dict[str, Any]:
    """Return the fields of `ArmConfig` that select the interface of the channels: SocketCAN or a virtual rig."""
    interface = interface or (VIRTUAL if rig else SOCKETCAN)
    return {"interface": interface, "can_options": {"rig": rig_name(rig)[0]} if interface == VIRTUAL or rig else {}}


def each_arm(args: argparse.Namespace) -> list[argparse.Namespace]:
    """Split the arguments into one namespace per arm; an option with a single value applies to all arms.

    Raises:
        ConfigError: there are more than two arms, or an option has neither one value nor one per arm.
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


def arm_config(args: argparse.Namespace, **fields: Any) -> ArmConfig:
    """Return the config of the arm that the arguments describe; --gripper, if given, replaces `fields["gripper"]`."""
    if args.gripper is not None:
        fields["gripper"] = args.gripper
    place = place_of(args.interface, args.rig)
    return ArmConfig(name=args.name or args.channel, channel=args.channel, arm=args.arm, **place, **fields)


def part_config(args: argparse.Namespace) -> ArmConfig | BaseConfig:
    """Return the config of the arm or, with `--arm base`, of the mobile base that the arguments describe."""
    if args.arm != BASE:
        return arm_config(args)
    return BaseConfig(name=args.name or args.channel, channel=args.channel, **place_of(args.interface, args.rig))


def with_answering_gripper(args: argparse.Namespace, bus: can.BusABC, **fields: Any) -> ArmConfig:
    """Return the config like `arm_config`; without --gripper, detect the gripper on the open bus.

    Raises:
        BusError: the channel is disconnected.
    """
    if args.gripper is not None:
        return arm_config(args, **fields)
    return arm_config(args, **fields, gripper=answering_gripper(bus, args.channel, gripper_id(load_arm(args.arm))))


def with_likely_gripper(args: argparse.Namespace, **fields: Any) -> ArmConfig:
    """Return the config like `arm_config`; without --gripper, detect and print the gripper. Energises nothing.

    An arm of a virtual rig weighs what the model says, so the maker's factors for real arms do not apply to it.

    Raises:
        BusError: the channel cannot be opened, or another program drives the arm.
    """
    if place_of(args.interface, args.rig)["interface"] == VIRTUAL and fields.get("tuning") is None:
        fields.setdefault("gravity_factor", [1.0] * load_arm(args.arm).joint_count)
    config = arm_config(args, **fields)
    if args.gripper is None:
        with own_bus(config) as bus:
            config = with_answering_gripper(args, bus, **fields)
        tell(f"{config.name}: taking the gripper to be {config.gripper} (else give --gripper)")
    return config


@contextmanager
def own_bus(config: ChannelConfig) -> Iterator[can.BusABC]:
    """Open a channel for exclusive use.

    Raises:
        ChannelInUseError: another process of this package holds the channel, or another program drives the motors.
        BusError: the channel cannot be opened.
    """
    key = channel_key(config.interface, config.channel, config.can_options.get("rig"))
    lock = FileLock(lock_path(key), f"CAN channel {config.channel}")
    lock.acquire()
    try:
        with open_bus(config) as bus:
            listen(bus, LISTEN_S, MOTOR_IDS, config.channel)
            yield bus
    finally:
        lock.release()


@contextmanager
def open_buses(arms: Sequence[ArmConfig]) -> Iterator[dict[str, can.BusABC]]:
    """Open the channels of several arms for exclusive use; yield channel -> bus. Raises the errors of `own_bus`."""
    with ExitStack() as stack:
        yield {config.channel: stack.enter_context(own_bus(config)) for config in arms}
