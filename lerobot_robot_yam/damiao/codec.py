"""Encoding and decoding of Damiao command and feedback frames: bytes <-> SI values. Pure, no I/O.

A quantity x in [min, max] is truncated to an unsigned code of `bits` bits:

    code = floor((x - min) * (2**bits - 1) / (max - min)),    x = code * (max - min) / (2**bits - 1) + min

The product is computed before the quotient: a precomputed factor would change the last bit of some frames.
MIT command, as a big-endian 64-bit word: position<<48 | velocity<<36 | kp<<24 | kd<<12 | torque.
Feedback: fault<<60 | id<<56 | position<<40 | velocity<<28 | torque<<16 | T_mos<<8 | T_rotor.
Sources: I2RT driver v1.2.4 for these layouts, Damiao's public drivers for the float32 frames.
"""

import struct
from enum import Enum
from math import inf, isfinite
from typing import NamedTuple

from lerobot_robot_yam.damiao import tables
from lerobot_robot_yam.errors import ActionError, BusError

_MAX16 = 0xFFFF
_MAX12 = 0xFFF
_ALL_ONES = 0xFFFF_FFFF_FFFF_FFFF
_FIRST_SPECIAL = 0xFFFF_FFFF_FFFF_FFFB  # smallest MIT command word that motors interpret as a special command
_FLOAT_PAIR = struct.Struct("<ff")

Ranges = tuple[float, float, float, float, float]  # (position_max, velocity_max, torque_max, kp_max, kd_max)

# Ranges of each motor type; commands and feedback use the same.
_ROWS: dict[str, Ranges] = {
    row.name: (row.position_max_rad, row.velocity_max_rad_s, row.torque_max_nm, row.kp_max, row.kd_max)
    for row in tables.MOTOR_TYPES.values()
}


class Feedback(NamedTuple):
    """State in a feedback frame: rad, rad/s, Nm, °C. `motor_id` is the low four bits of the CAN id."""

    motor_id: int
    fault: int
    position: float
    velocity: float
    torque: float
    temp_mos: int
    temp_rotor: int


class MitCommand(NamedTuple):
    """MIT command, motor torque = kp (position - q) + kd (velocity - dq) + torque: rad, rad/s, Nm/rad, Nm s/rad, Nm."""

    position: float
    velocity: float
    kp: float
    kd: float
    torque: float


class SpecialCommand(Enum):
    """Payload that changes a motor's state; sent to the motor's own CAN id."""

    ENABLE = b"\xff\xff\xff\xff\xff\xff\xff\xfc"
    DISABLE = b"\xff\xff\xff\xff\xff\xff\xff\xfd"
    ZERO = b"\xff\xff\xff\xff\xff\xff\xff\xfe"
    CLEAR = b"\xff\xff\xff\xff\xff\xff\xff\xfb"


SPECIAL_OF = {command.value: command for command in SpecialCommand}  # payload -> special command


def encode_mit(motor_type: str, position: float, velocity: float, kp: float, kd: float, torque: float) -> bytes:
    """Encode an MIT command, 8 bytes, to be sent to the motor's own CAN id. Units: rad, rad/s, Nm/rad, Nm s/rad, Nm.

    Values outside the ranges of the motor type are clamped: the frame cannot represent others.

    Raises:
        ActionError: a value is NaN or infinite.
        ConfigError: unknown motor type.
    """
    # A finite float sum implies finite terms; if the sum is not finite or overflows, `_finite` checks each term.
    try:
        total = position + velocity + kp + kd + torque
        plain = type(total) is float and isfinite(total)
    except OverflowError:  # an integer too large for a float
        plain = False
    if not plain:  # also for numpy's small types, which overflow in the arithmetic below
        position, velocity, kp, kd, torque = _finite(position=position, velocity=velocity, kp=kp, kd=kd, torque=torque)
    try:
        ranges = _ROWS[motor_type]
    except KeyError:
        ranges = ranges_of(motor_type)  # raises ConfigError, which lists the known types
    return pack_mit(ranges, position, velocity, kp, kd, torque, make_up=False)


def pack_mit(
    ranges: Ranges, position: float, velocity: float, kp: float, kd: float, torque: float, make_up: bool = True
) -> bytes:
    """Encode an MIT command like `encode_mit`, without its checks: for finite floats and known ranges, in the loop.

    Zero velocity has no code: it is sent as minus half a step. At kd = 1.5 Nm s/rad that is 11 mNm, which leaves a
    wrist with kp = 10 Nm/rad 1.1 mrad off. With `make_up`, the torque compensates these errors, which are known:

        tau ← tau + kp (q* − q*_sent) + kd (dq* − dq*_sent) + half a torque step
    """
    p_max, v_max, t_max, kp_max, kd_max = ranges
    p_range, v_range, t_range = p_max + p_max, v_max + v_max, t_max + t_max
    position = p_max if position > p_max else -p_max if position < -p_max else position
    velocity = v_max if velocity > v_max else -v_max if velocity < -v_max else velocity
    kp = kp_max if kp > kp_max else 0.0 if kp < 0.0 else kp
    kd = kd_max if kd > kd_max else 0.0 if kd < 0.0 else kd
    position_code = int((position + p_max) * _MAX16 / p_range)
    velocity_code = int((velocity + v_max) * _MAX12 / v_range)
    if make_up:
        torque += (
            kp * (position + p_max - position_code * p_range / _MAX16)
            + kd * (velocity + v_max - velocity_code * v_range / _MAX12)
            + t_max / _MAX12
        )
    torque = t_max if torque > t_max else -t_max if torque < -t_max else torque
    word = (
        position_code << 48
        | velocity_code << 36
        | int(kp * _MAX12 / kp_max) << 24
        | int(kd * _MAX12 / kd_max) << 12
        | int((torque + t_max) * _MAX12 / t_range)
    )
    if word >= _FIRST_SPECIAL:
        # All fields saturated: a torque a few codes below its maximum would turn the word into "disable" or another
        # special command. The word with maximum torque is not a special command.
        word = _ALL_ONES
    return word.to_bytes(8, "big")


def decode_mit(motor_type: str, data: bytes) -> MitCommand:
    """Decode an MIT command: the inverse of `encode_mit` up to quantisation.

    Raises:
        BusError: `data` is not 8 bytes long.
        ConfigError: unknown motor type.
    """
    if len(data) != 8:
        raise _wrong_length("MIT command", data)
    return MitCommand(*unpack_mit(ranges_of(motor_type), data))


def unpack_mit(ranges: Ranges, data: bytes) -> tuple[float, float, float, float, float]:
    """Decode 8 bytes like `decode_mit`, without its checks, for the virtual rig; same order of fields."""
    p_max, v_max, t_max, kp_max, kd_max = ranges
    word = int.from_bytes(data, "big")
    return (
        (word >> 48) * (p_max + p_max) / _MAX16 - p_max,
        (word >> 36 & _MAX12) * (v_max + v_max) / _MAX12 - v_max,
        (word >> 24 & _MAX12) * kp_max / _MAX12,
        (word >> 12 & _MAX12) * kd_max / _MAX12,
        (word & _MAX12) * (t_max + t_max) / _MAX12 - t_max,
    )


def decode_feedback(motor_type: str, data: bytes) -> Feedback:
    """Decode a feedback frame (8 bytes) to rad, rad/s, Nm, °C.

    Raises:
        BusError: `data` is not 8 bytes long.
        ConfigError: unknown motor type.
    """
    if len(data) != 8:
        raise _wrong_length("feedback", data)
    return Feedback(*unpack_feedback(ranges_of(motor_type), data))


def ranges_of(motor_type: str) -> Ranges:
    """Return the ranges that scale the frames of this motor type. Raises ConfigError: unknown type."""
    return _ROWS[tables.motor_type(motor_type).name]


def torque_step_nm(motor_type: str) -> float:
    """Return the resolution of a motor type's torque feedback, Nm, rounded down. Raises ConfigError: unknown type."""
    return 2.0 * ranges_of(motor_type)[2] / _MAX12


def unpack_feedback(ranges: Ranges, data: bytes) -> tuple[int, int, float, float, float, int, int]:
    """Decode 8 bytes like `decode_feedback`, without its checks, for the loop; same fields, the id first."""
    p_max, v_max, t_max, _, _ = ranges
    word = int.from_bytes(data, "big")
    return (
        word >> 56 & 0xF,
        word >> 60,
        (word >> 40 & _MAX16) * (p_max + p_max) / _MAX16 - p_max,
        (word >> 28 & _MAX12) * (v_max + v_max) / _MAX12 - v_max,
        (word >> 16 & _MAX12) * (t_max + t_max) / _MAX12 - t_max,
        word >> 8 & 0xFF,
        word & 0xFF,
    )


def pack_feedback(
    ranges: Ranges, status: int, position: float, velocity: float, torque: float, temp_mos: int, temp_rotor: int
) -> bytes:
    """Encode a feedback frame for the virtual rig. Finite values are clamped; `status` is fault << 4 | id."""
    p_max, v_max, t_max, _, _ = ranges
    position = p_max if position > p_max else -p_max if position < -p_max else position
    velocity = v_max if velocity > v_max else -v_max if velocity < -v_max else velocity
    torque = t_max if torque > t_max else -t_max if torque < -t_max else torque
    word = (
        (status & 0xFF) << 56
        | int((position + p_max) * _MAX16 / (p_max + p_max)) << 40
        | int((velocity + v_max) * _MAX12 / (v_max + v_max)) << 28
        | int((torque + t_max) * _MAX12 / (t_max + t_max)) << 16
        | (temp_mos if 0 <= temp_mos <= 0xFF else 0 if temp_mos < 0 else 0xFF) << 8
        | (temp_rotor if 0 <= temp_rotor <= 0xFF else 0 if temp_rotor < 0 else 0xFF)
    )
    return word.to_bytes(8, "big")


def encode_position_velocity(position_rad: float, speed_rad_s: float) -> bytes:
    """Encode a position-velocity command (target, speed limit), sent to `POSITION_VELOCITY_OFFSET` + motor id.

    Raises:
        ActionError: a value is NaN or infinite.
    """
    return _FLOAT_PAIR.pack(*_finite(position=position_rad, speed=speed_rad_s))


def encode_velocity(velocity_rad_s: float) -> bytes:
    """Encode a velocity command, sent to `VELOCITY_OFFSET` + motor id. Raises ActionError: NaN or infinite."""
    return _FLOAT_PAIR.pack(*_finite(velocity=velocity_rad_s), 0.0)


def decode_position_velocity(data: bytes) -> tuple[float, float]:
    """Decode a position-velocity command to (rad, speed limit rad/s), or a velocity command to (rad/s, 0).

    Raises:
        BusError: `data` is not 8 bytes long.
    """
    if len(data) != 8:
        raise _wrong_length("position-velocity command", data)
    position, velocity_limit = _FLOAT_PAIR.unpack(data)
    return position, velocity_limit


def _finite(**values: float) -> list[float]:
    """Convert values to plain floats. Raises ActionError: a value is not finite; the message names it."""
    plain = []
    for name, value in values.items():
        try:
            number = float(value)
        except OverflowError:
            number = inf
        if not isfinite(number):
            raise ActionError(f"{name} of a motor command is {number}; nothing was sent, check its source")
        plain.append(number)
    return plain


def _wrong_length(what: str, data: bytes) -> BusError:
    return BusError(f"a {what} has 8 bytes, not {len(data)}: {bytes(data).hex(' ')}")
