"""Beside a running session: how late and how often its motors answer. It only listens, and takes no lock."""

import argparse
import json
import sys

from lerobot_robot_yam.commands.lib.arm_command import arm_config, table, tell
from lerobot_robot_yam.commands.lib.motor.motor_bench import motor_names
from lerobot_robot_yam.control.preflight.open_bus import open_bus
from lerobot_robot_yam.damiao.settings.traffic import Traffic
from lerobot_robot_yam.errors import MotorError

_HEAD = ["motor", "commands", "lost", "p50 ms", "p99 ms", "max ms", "period p50 ms", "p99 ms", "max ms"]


def monitor_session(args: argparse.Namespace) -> int:
    """`yam-motors monitor`."""
    config, traffic = arm_config(args), Traffic()
    names = motor_names(config)
    bus = open_bus(config)
    try:
        traffic.listen(bus, config.channel, args.seconds)
    finally:
        bus.shutdown()
    if not traffic.frames:
        raise MotorError(
            f"nothing was heard on channel {config.channel} within {args.seconds:g} s: no session drives it, or its "
            "link is down"
        )
    figures = {can_id: heard.figures() for can_id, heard in sorted(traffic.motors.items())}
    load = round(traffic.load(args.seconds), 3)
    if args.json:
        others = {f"0x{identifier:X}": count for identifier, count in traffic.others.items()}
        facts = {"channel": config.channel, "load": load, "error_frames": traffic.error_frames, "others": others}
        sys.stdout.write(json.dumps({**facts, "motors": {str(i): row for i, row in figures.items()}}) + "\n")
        return 0
    rows = [[names.get(i, f"motor {i}"), *map(_text, row.values())] for i, row in figures.items()]
    sys.stdout.write(table(_HEAD, rows) + "\n")
    tell(f"the wire was busy for {load:.0%} of the time; {traffic.error_frames} error frames")
    return 0


def _text(value: float | None) -> str:
    return "–" if value is None else f"{value:g}"
