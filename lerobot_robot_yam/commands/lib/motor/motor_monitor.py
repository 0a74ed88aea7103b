"""Monitor of a running session: latency, period and losses of motor replies. Listens only, and takes no lock.

A motor replies to each command once, long before the next command. A reply is therefore assigned to the newest command
before the reply; a command followed by another command without a reply in between counts as lost.
"""

import argparse
import json
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from itertools import pairwise

import can
import numpy as np

from lerobot_robot_yam.commands.lib.arm_command import part_config
from lerobot_robot_yam.commands.lib.dialogue import say, table, tell
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
    """Run `yam-motors monitor`: listen on a bus, and print latencies, periods and lost replies."""
    config = part_config(args)
    names = motor_names(config)
    bus = open_bus(config)
    try:
        heard = Traffic(_frames(bus, config.channel, args.seconds))
    finally:
        bus.shutdown()
    if not heard.frames:
        raise MotorError(
            f"nothing was heard on channel {config.channel} within {args.seconds:g} s: no session drives it, or its "
            "link is down"
        )
    load = round(heard.frames * FRAME_TIME_S / args.seconds, 3)  # upper bound: all frames count as longest
    if args.json:
        others = {f"0x{identifier:X}": count for identifier, count in heard.others.items()}
        facts = {"channel": config.channel, "load": load, "error_frames": heard.error_frames, "others": others}
        say(json.dumps({**facts, "motors": heard.figures()}))
        return 0
    rows = [
        [names.get(i, f"motor {i}"), *("–" if value is None else f"{value:g}" for value in row.values())]
        for i, row in heard.figures().items()
    ]
    say(table(_HEAD, rows))
    tell(f"the wire was busy for {load:.0%} of the time; {heard.error_frames} error frames")
    return 0


def _frames(bus: can.BusABC, channel: str, seconds: float) -> Iterator[can.Message]:
    """Yield the frames that arrive within `seconds`. Raises BusError: the channel is disconnected."""
    port = BusPort(bus, channel)
    deadline = port.clock.now() + seconds
    while (remaining := deadline - port.clock.now()) > 0.0:
        message = port.recv(remaining)
        if message is not None:
            yield message


class Traffic:
    """Statistics of all frames on a bus.

    Args:
        messages: frames in order of arrival, with timestamps.

    Attributes:
        others: identifier that belongs to no motor -> number of frames with this identifier.
        error_frames: number of error frames reported by the CAN controller.
        frames: number of data frames.
    """

    def __init__(self, messages: Iterable[can.Message]):
        self._heard: defaultdict[int, list[tuple[float, bool]]] = defaultdict(list)  # (timestamp, is a command)
        self.others: Counter[int] = Counter()
        self.error_frames = self.frames = 0
        for message in messages:
            if not is_classic_data(message):
                self.error_frames += message.is_error_frame
                continue
            self.frames += 1
            identifier = message.arbitration_id
            can_id = _COMMANDED.get(identifier, identifier - ANSWERS_BEYOND)
            if can_id in MOTOR_IDS:
                self._heard[can_id].append((message.timestamp, identifier in _COMMANDED))
            else:
                self.others[identifier] += 1

    def figures(self) -> dict[int, dict[str, float | None]]:
        """Return CAN id -> numbers of commands and lost replies; p50, p99, max of latency and period, ms, or None."""
        found: dict[int, dict[str, float | None]] = {}
        for can_id, heard in sorted(self._heard.items()):
            commands_s = [at_s for at_s, command in heard if command]
            latency_s = [then_s - at_s for (at_s, first), (then_s, second) in pairwise(heard) if first and not second]
            lost = sum(first and second for (_, first), (_, second) in pairwise(heard))
            found[can_id] = {"commands": len(commands_s), "lost": lost}
            for name, times_s in (("latency_ms", latency_s), ("period_ms", np.diff(commands_s))):
                values = (np.percentile(times_s, (50, 99, 100)) * 1e3).round(3).tolist() if len(times_s) else [None] * 3
                found[can_id] |= {f"{name}_{q}": value for q, value in zip(("p50", "p99", "max"), values, strict=True)}
        return found
