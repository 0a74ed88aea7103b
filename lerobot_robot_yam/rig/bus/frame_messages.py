"""python-can's messages as frames of the rig, for both of its interfaces."""

from collections.abc import Sequence

import can

from lerobot_robot_yam.errors import BusError
from lerobot_robot_yam.rig.devices import packets
from lerobot_robot_yam.rig.devices.packets import Frame


def pack_messages(messages: Sequence[can.Message], now_s: float) -> bytes:
    """Messages that are sent now, as one packet.

    Raises:
        BusError: one is not classic CAN.
    """
    records = []
    for message in messages:
        if message.is_fd:
            raise BusError(f"CAN FD frame {message.arbitration_id:#x} sent; the arms speak classic CAN")
        flags = message.is_extended_id * packets.FLAG_EXTENDED | message.is_remote_frame * packets.FLAG_REMOTE
        records.append(packets.pack_one(now_s, message.arbitration_id, message.data, flags))
    return b"".join(records)


def message_of(frame: Frame, channel: str) -> can.Message:
    """A frame as a receiver gets it."""
    stamp_s, ident, data, flags = frame
    return can.Message(
        timestamp=stamp_s,
        arbitration_id=ident,
        is_extended_id=bool(flags & packets.FLAG_EXTENDED),
        is_remote_frame=bool(flags & packets.FLAG_REMOTE),
        is_error_frame=bool(flags & packets.FLAG_ERROR),
        data=data,
        channel=channel,
    )
