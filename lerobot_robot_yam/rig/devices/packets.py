"""Packets between a bus client and the rig, and the time that their frames occupy the wire.

A packet consists of 24-byte records (stamp, identifier, length, flags, data). In packets sent to the rig, the stamp is
the time at which `send` was called. In packets to the client, the stamp is the time at which the wire delivers the
frame; the client waits until then. A whole tick thus travels as one packet each way and takes as long as on a real bus.
"""

import struct
from collections.abc import Iterable, Sequence
from itertools import accumulate, repeat
from typing import NamedTuple

import can

from lerobot_robot_yam.damiao.tables import FRAME_TIME_S
from lerobot_robot_yam.errors import BusError

_RECORD = struct.Struct("<dIBBxx8s")
RECORD_SIZE = _RECORD.size

FLAG_EXTENDED = 1
FLAG_REMOTE = 2
FLAG_ERROR = 4  # frame of the interface itself, never on the wire

WAKE = b"\0"  # a packet without frames, which makes the receiver check its link

_OLDEST_SEND_S = 0.05  # maximum age of a send stamp, s; older stamps, of a descheduled sender, are clamped


class Frame(NamedTuple):
    """One CAN frame with the monotonic time at which it was sent or delivered, s; see the module's docstring."""

    stamp_s: float
    id: int
    data: bytes
    flags: int = 0


def pack(frames: Iterable[Frame]) -> bytes:
    return b"".join([pack_one(*frame) for frame in frames])


def pack_one(stamp_s: float, ident: int, data: bytes | bytearray, flags: int) -> bytes:
    return _RECORD.pack(stamp_s, ident, len(data), flags, data)


def unpack(packet: bytes) -> list[Frame]:
    """Decode a packet. Raises BusError: the packet size is not a multiple of the record size."""
    if len(packet) % RECORD_SIZE:
        raise BusError(f"a packet of {len(packet)} bytes is not made of {RECORD_SIZE}-byte records")
    return [
        Frame(stamp, ident, data[:length], flags) for stamp, ident, length, flags, data in _RECORD.iter_unpack(packet)
    ]


def pack_messages(messages: Sequence[can.Message], now_s: float) -> bytes:
    """Encode python-can messages, sent at `now_s`, as one packet. Raises BusError: a message is not classic CAN."""
    records = []
    for message in messages:
        if message.is_fd:
            raise BusError(f"CAN FD frame {message.arbitration_id:#x} sent; the arms speak classic CAN")
        flags = message.is_extended_id * FLAG_EXTENDED | message.is_remote_frame * FLAG_REMOTE
        records.append(pack_one(now_s, message.arbitration_id, message.data, flags))
    return b"".join(records)


def message_of(frame: Frame, channel: str) -> can.Message:
    """Convert a received frame to a python-can message."""
    stamp_s, ident, data, flags = frame
    return can.Message(
        timestamp=stamp_s,
        arbitration_id=ident,
        is_extended_id=bool(flags & FLAG_EXTENDED),
        is_remote_frame=bool(flags & FLAG_REMOTE),
        is_error_frame=bool(flags & FLAG_ERROR),
        data=data,
        channel=channel,
    )


class Wire:
    """Occupancy of one bus: frames follow one another, `FRAME_TIME_S` each, in the order of the calls.

    Callers must pass frames that are ready at the same time in the order of CAN arbitration: commands before replies,
    whose identifiers are higher.
    """

    def __init__(self) -> None:
        self.free_at_s = 0.0
        self.frames = 0

    def transmit(self, ready_s: float) -> float:
        """Transmit a frame that is ready at `ready_s`; return the time at which it is delivered, s."""
        start = ready_s if ready_s > self.free_at_s else self.free_at_s
        self.free_at_s = start + FRAME_TIME_S
        self.frames += 1
        return self.free_at_s

    def transmit_all(self, ready_s: float, count: int) -> list[float]:
        """Transmit `count` frames that are ready at `ready_s`; return the time at which each is delivered, s."""
        start = ready_s if ready_s > self.free_at_s else self.free_at_s
        _, *through_s = accumulate(repeat(FRAME_TIME_S, count), initial=start)
        self.free_at_s = through_s[-1]
        self.frames += count
        return through_s


def send_time(stamp_s: float, now_s: float) -> float:
    """Clamp a client's send stamp to plausible times at `now_s`; NaN counts as old."""
    return min(max(now_s - _OLDEST_SEND_S, stamp_s), now_s)  # max returns its first argument if the other is NaN
