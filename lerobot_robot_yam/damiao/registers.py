"""Damiao register protocol on CAN id 0x7FF: requests, replies and the register table. Pure, no I/O.

Request: motor id (2 bytes, little-endian), opcode, register, value (4 bytes, little-endian).
Reply, sent to the motor's MST_ID: the same layout, with the current value. A feedback frame can have the same bytes by
chance, so a frame may only be decoded as a reply while a request is outstanding.
Sources: DM_Control_Python, python-damiao-driver, motorbridge, I2RT driver v1.2.4.
"""

import contextlib
import math
import struct
from enum import IntEnum
from typing import Any, Literal, NamedTuple

from lerobot_robot_yam.errors import ConfigError

_HEADER = struct.Struct("<HBB4s")
_FLOAT = struct.Struct("<f")
_UINT = struct.Struct("<I")
_ZEROS = b"\x00\x00\x00\x00"


class Opcode(IntEnum):
    """Opcode of a request, byte 2."""

    READ = 0x33
    WRITE = 0x55
    STORE = 0xAA
    REFRESH = 0xCC


class Register(IntEnum):
    """Register number (byte 3), with the type of its four bytes, whether it is writable, and its unit ("": none)."""

    kind: Literal["float", "uint32"]
    writable: bool
    unit: str

    def __new__(cls, number: int, kind: Literal["float", "uint32"], writable: bool, unit: str) -> "Register":
        member = int.__new__(cls, number)
        member._value_, member.kind, member.writable, member.unit = number, kind, writable, unit
        return member

    UV_VALUE = 0, "float", True, "V"
    KT_VALUE = 1, "float", True, "Nm/A"
    OT_VALUE = 2, "float", True, "°C"
    OC_VALUE = 3, "float", True, "ratio"
    ACC = 4, "float", True, "rad/s^2"
    DEC = 5, "float", True, "rad/s^2"
    MAX_SPD = 6, "float", True, "rad/s"
    MST_ID = 7, "uint32", True, "CAN id"
    ESC_ID = 8, "uint32", True, "CAN id"
    TIMEOUT = 9, "uint32", True, "50 µs"
    CTRL_MODE = 10, "uint32", True, "enum"
    DAMP = 11, "float", False, ""
    INERTIA = 12, "float", False, "kg m^2"
    HW_VER = 13, "uint32", False, ""
    SW_VER = 14, "uint32", False, ""
    SN = 15, "uint32", False, ""
    NPP = 16, "uint32", False, ""
    RS = 17, "float", False, "ohm"
    LS = 18, "float", False, "H"
    FLUX = 19, "float", False, "Wb"
    GR = 20, "float", False, ""
    PMAX = 21, "float", True, "rad"
    VMAX = 22, "float", True, "rad/s"
    TMAX = 23, "float", True, "Nm"
    I_BW = 24, "float", True, ""
    KP_ASR = 25, "float", True, ""
    KI_ASR = 26, "float", True, ""
    KP_APR = 27, "float", True, ""
    KI_APR = 28, "float", True, ""
    OV_VALUE = 29, "float", True, "V"
    GREF = 30, "float", True, "ratio"
    DETA = 31, "float", True, ""
    V_BW = 32, "float", True, ""
    IQ_C1 = 33, "float", True, ""
    VL_C1 = 34, "float", True, ""
    CAN_BR = 35, "uint32", True, "enum"
    SUB_VER = 36, "uint32", False, ""
    U_OFF = 50, "float", False, ""
    V_OFF = 51, "float", False, ""
    K1 = 52, "float", False, ""
    K2 = 53, "float", False, ""
    M_OFF = 54, "float", False, ""
    DIR = 55, "float", False, ""
    M_OFF_MOTOR = 56, "float", False, ""  # m_off on the motor side of the gear
    IMAX = 59, "float", False, "A"
    VBUS = 60, "float", False, "V"
    TPCB = 61, "float", False, "°C"
    TMTR = 62, "float", False, "°C"
    IU_OFF = 63, "float", False, ""
    IV_OFF = 64, "float", False, ""
    IW_OFF = 65, "float", False, ""
    P_M = 80, "float", False, "rad"
    XOUT = 81, "float", False, "rad"


REGISTERS = {register.value: register for register in Register}


class RegisterFrame(NamedTuple):
    """Decoded request or reply. In requests, `register` may be unknown, and `value` is None except in writes."""

    motor_id: int
    opcode: int
    register: int
    value: Any


def register_row(register: int) -> Register:
    """Return the register with this number. Raises ConfigError: Damiao motors have no such register."""
    try:
        return REGISTERS[register]
    except KeyError:
        raise ConfigError(f"no register {register}; known: {', '.join(r.name for r in Register)}") from None


def encode_read(motor_id: int, register: int) -> bytes:
    """Encode a request to read a register of motor `motor_id`, 8 bytes for CAN id 0x7FF."""
    register_row(register)
    return _HEADER.pack(motor_id, Opcode.READ, register, _ZEROS)


def encode_write(motor_id: int, register: int, value: float) -> bytes:
    """Encode a write to a register in the motor's RAM; `encode_store` makes the value survive a power cycle.

    Raises:
        ConfigError: the register is unknown or read-only, or cannot hold the value.
    """
    row = register_row(register)
    if not row.writable:
        raise ConfigError(f"register {row.name} of motor {motor_id} is read-only")
    return _HEADER.pack(motor_id, Opcode.WRITE, register, encode_value(register, value))


def encode_store(motor_id: int) -> bytes:
    """Encode a command that stores all registers of the motor in flash."""
    return _HEADER.pack(motor_id, Opcode.STORE, 1, _ZEROS)


def encode_refresh(motor_id: int) -> bytes:
    """Encode a request for a feedback frame; it neither enables the motor nor commands motion."""
    return _HEADER.pack(motor_id, Opcode.REFRESH, 0, _ZEROS)


def decode_request(data: bytes) -> RegisterFrame | None:
    """Decode a 0x7FF frame as a motor does; return None if the frame is no valid request."""
    if not 4 <= len(data) <= 8:
        return None
    motor_id, opcode, register, raw = _HEADER.unpack(bytes(data).ljust(8, b"\x00"))
    if opcode == Opcode.WRITE and register in REGISTERS:
        return RegisterFrame(motor_id, opcode, register, decode_value(register, raw))
    if opcode in (Opcode.READ, Opcode.STORE, Opcode.REFRESH):
        return RegisterFrame(motor_id, opcode, register, None)
    return None


def encode_reply(motor_id: int, opcode: int, register: int, value: float) -> bytes:
    """Encode a motor's reply to a read or write, with the current value."""
    return _HEADER.pack(motor_id, opcode, register, encode_value(register, value))


def decode_reply(data: bytes) -> RegisterFrame | None:
    """Decode the reply to a read or write; return None if the frame is not such a reply but feedback."""
    if len(data) != 8 or data[1] > 7 or data[2] not in (Opcode.READ, Opcode.WRITE) or data[3] not in REGISTERS:
        return None
    motor_id, opcode, register, raw = _HEADER.unpack(data)
    return RegisterFrame(motor_id, opcode, register, decode_value(register, raw))


def encode_value(register: int, value: float) -> bytes:
    """Encode a value as the register's four little-endian bytes. Raises ConfigError: unknown register or bad value."""
    row = register_row(register)
    with contextlib.suppress(OverflowError, ValueError, TypeError, struct.error):  # too large, NaN, not a number
        if row.kind == "float":
            if math.isfinite(value):
                return _FLOAT.pack(value)
        elif int(value) == value:
            return _UINT.pack(int(value))
    takes = "a finite float32" if row.kind == "float" else "an integer from 0 to 2^32 - 1"
    raise ConfigError(f"register {row.name} cannot hold {value}: it takes {takes}")


def decode_value(register: int, raw: bytes) -> float | int:
    """Decode a register's four bytes to a float or int, according to the register's kind."""
    packer = _FLOAT if register_row(register).kind == "float" else _UINT
    value: float | int = packer.unpack(raw)[0]
    return value


def agrees(found: float | None, expected: float | None) -> bool:
    """Return whether a float32 register value equals a rounded constant; False if either is None (unknown)."""
    return found is not None and expected is not None and math.isclose(found, expected, rel_tol=1e-4)
