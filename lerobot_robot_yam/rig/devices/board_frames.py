"""Frames between the rig's board for a rail and its driver, and the channel that carries them."""

import can

from lerobot_robot_yam.damiao.handle_encoder import REQUEST_ID


def board_channel(base: str) -> str:
    """Return the name of the board's channel for the base on the channel `base`."""
    return f"{base}_io"


def encode_request(brake_on: bool) -> can.Message:
    """Encode a request to the board."""
    return can.Message(arbitration_id=REQUEST_ID, data=bytes((brake_on,)), is_extended_id=False)


def decode_report(data: bytes) -> tuple[bool, bool, bool]:
    """Return whether upper switch and lower switch are triggered, and whether the brake's output engages it."""
    upper, lower, brake_on = (bool(byte) for byte in data[:3])
    return upper, lower, brake_on
