"""Beside a running session: how late and how often its motors answer. It only listens, and takes no lock.

A motor answers each command once, within much less than the time to the next. So an answer belongs to the newest
command before it, and a command that is followed by another one without an answer in between is lost.
"""

import argparse
import json
import sys
from collections import Counter
from dataclasses import dataclass, field

import can
import numpy as np

from lerobot_robot_yam.commands.lib.arm_command import arm_config, table, tell
from lerobot_robot_yam.commands.lib.motor.motor_bench import ANSWERS_BEYOND, motor_names
from lerobot_robot_yam.control.preflight.open_bus import open_bus
from lerobot_robot_yam.damiao.bus_port import BusPort, is_classic_data
from lerobot_robot_yam.damiao.motor_spec import MOTOR_IDS
from lerobot_robot_yam.damiao.tables import (
    FORCE_POSITION_OFFSET,
    FRAME_TIME_S,
    POSITION_VELOCITY_OFFSET,
    VELOCITY_OFFSET,
)
from lerobot_robot_yam.errors import MotorError

_HEAD = ["motor", "commands", "lost", "p50 ms", "p99 ms", "max ms", "period p50 ms", "p99 ms", "max ms"]
_OFFSETS = (0, POSITION_VELOCITY_OFFSET, VELOCITY_OFFSET, FORCE_POSITION_OFFSET)
_COMMANDED = {offset + can_id: can_id for can_id in MOTOR_IDS for offset in _OFFSETS}


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


@dataclass
class Heard:
    """Of one motor: commands, those that were answered, the time to each answer and between commands, in s."""

    commands: int = 0
    lost: int = 0
    latency_s: list[float] = field(default_factory=list)
    period_s: list[float] = field(default_factory=list)
    _asked_s: float | None = None
    _open: bool = False

    def command(self, at_s: float) -> None:
        """One was sent."""
        if self._asked_s is not None:
            self.period_s.append(at_s - self._asked_s)
        self.lost += self._open
        self.commands += 1
        self._asked_s, self._open = at_s, True

    def answer(self, at_s: float) -> None:
        """One came."""
        if self._open and self._asked_s is not None:
            self.latency_s.append(at_s - self._asked_s)
        self._open = False

    def figures(self) -> dict[str, float | None]:
        """Commands, lost answers, and p50, p99 and maximum in ms; None where nothing was heard to tell them."""
        found: dict[str, float | None] = {"commands": self.commands, "lost": self.lost}
        for name, seconds in (("latency_ms", self.latency_s), ("period_ms", self.period_s)):
            values = (np.percentile(seconds, (50, 99, 100)) * 1e3).round(3).tolist() if seconds else [None] * 3
            found |= {f"{name}_{q}": value for q, value in zip(("p50", "p99", "max"), values, strict=True)}
        return found


class Traffic:
    """Everything that is heard on a bus.

    Attributes:
        motors: by CAN id, those that were commanded or have answered.
        others: other identifiers with their counts.
        error_frames: of the controller.
        frames: all data frames.
    """

    def __init__(self) -> None:
        self.motors: dict[int, Heard] = {}
        self.others: Counter[int] = Counter()
        self.error_frames = self.frames = 0

    def listen(self, bus: can.BusABC, channel: str, seconds: float) -> None:
        """Take what comes within a time. Raises BusError: the channel is gone."""
        port = BusPort(bus, channel)
        deadline = port.clock.now() + seconds
        while (remaining := deadline - port.clock.now()) > 0.0:
            message = port.recv(remaining)
            if message is not None:
                self.take(message)

    def take(self, message: can.Message) -> None:
        """One frame, by its own time stamp."""
        if not is_classic_data(message):
            self.error_frames += message.is_error_frame
            return
        self.frames += 1
        identifier, at_s = message.arbitration_id, message.timestamp
        if identifier in _COMMANDED:
            self.motors.setdefault(_COMMANDED[identifier], Heard()).command(at_s)
        elif identifier - ANSWERS_BEYOND in MOTOR_IDS:
            self.motors.setdefault(identifier - ANSWERS_BEYOND, Heard()).answer(at_s)
        else:
            self.others[identifier] += 1

    def load(self, seconds: float) -> float:
        """Share of the wire that was busy, with frames of the longest kind."""
        return self.frames * FRAME_TIME_S / seconds
