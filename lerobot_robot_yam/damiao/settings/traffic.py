"""Latency and loss of the motors of a bus that somebody else drives, from what is heard; nothing is sent.

A motor answers each command once, within much less than the time to the next. So an answer belongs to the newest
command before it, and a command that is followed by another one without an answer in between is lost.
"""

from collections import Counter
from dataclasses import dataclass, field

import can
import numpy as np

from lerobot_robot_yam.damiao.bus_port import BusPort, is_classic_data
from lerobot_robot_yam.damiao.motor_spec import MOTOR_IDS
from lerobot_robot_yam.damiao.tables import (
    FORCE_POSITION_OFFSET,
    FRAME_TIME_S,
    POSITION_VELOCITY_OFFSET,
    VELOCITY_OFFSET,
)

_OFFSETS = (0, POSITION_VELOCITY_OFFSET, VELOCITY_OFFSET, FORCE_POSITION_OFFSET)
_COMMANDED = {offset + can_id: can_id for can_id in MOTOR_IDS for offset in _OFFSETS}
_ANSWERS_AS = 16


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
        elif identifier - _ANSWERS_AS in MOTOR_IDS:
            self.motors.setdefault(identifier - _ANSWERS_AS, Heard()).answer(at_s)
        else:
            self.others[identifier] += 1

    def load(self, seconds: float) -> float:
        """Share of the wire that was busy, with frames of the longest kind."""
        return self.frames * FRAME_TIME_S / seconds
