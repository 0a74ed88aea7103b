"""Damiao register protocol on identifier 0x7FF: requests, replies and the register table. Pure, no I/O.

Request: motor id (2 bytes, little-endian), opcode, register, value (4 bytes, little-endian).
Reply, on the motor's MST_ID: the same layout with the value held. A feedback frame can look the same by
chance, so a reply is only meaningful for an outstanding request.
Sources: DM_Control_Python, python-damiao-driver, motorbridge, I2RT driver v1.2.4.
"""

import contextlib
import math
import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal, NamedTuple

from lerobot_robot_yam.errors import ConfigError

_HEADER = struct.Struct("<HBB4s")
_FLOAT = struct.Struct("<f")
_UINT = struct.Struct("<I")
_ZEROS = b"\x00\x00\x00\x00"


class Opcode(IntEnum):
    """Byte 2 of a request."""

    READ = 0x33
    WRITE = 0x55
    STORE = 0xAA
    REFRESH = 0xCC


class Register(IntEnum):
    """Register numbers (byte 3)."""

    UV_VALUE = 0
    KT_VALUE = 1
    OT_VALUE = 2
    OC_VALUE = 3
    ACC = 4
    DEC = 5
    MAX_SPD = 6
    MST_ID = 7
    ESC_ID = 8
    TIMEOUT = 9
    CTRL_MODE = 10
    DAMP = 11
    INERTIA = 12
    HW_VER = 13
    SW_VER = 14
    SN = 15
    NPP = 16
    RS = 17
    LS = 18
    FLUX = 19
    GR = 20
    PMAX = 21
    VMAX = 22
    TMAX = 23
    I_BW = 24
    KP_ASR = 25
    KI_ASR = 26
    KP_APR = 27
    KI_APR = 28
    OV_VALUE = 29
    GREF = 30
    DETA = 31
    V_BW = 32
    IQ_C1 = 33
    VL_C1 = 34
    CAN_BR = 35
    SUB_VER = 36
    U_OFF = 50
    V_OFF = 51
    K1 = 52
    K2 = 53
    M_OFF = 54
    DIR = 55
    M_OFF_MOTOR = 56
    IMAX = 59
    VBUS = 60
    TPCB = 61
    TMTR = 62
    IU_OFF = 63
    IV_OFF = 64
    IW_OFF = 65
    P_M = 80
    XOUT = 81


@dataclass(frozen=True)
class RegisterRow:
    """One register: Damiao's name, kind of its four bytes, whether it can be written, unit ("" if none)."""

    name: str
    kind: Literal["float", "uint32"]
    writable: bool
    unit: str


_R = Register
REGISTERS: dict[int, RegisterRow] = {
    _R.UV_VALUE: RegisterRow("UV_Value", "float", True, "V"),
    _R.KT_VALUE: RegisterRow("KT_Value", "float", True, "Nm/A"),
    _R.OT_VALUE: RegisterRow("OT_Value", "float", True, "°C"),
    _R.OC_VALUE: RegisterRow("OC_Value", "float", True, "ratio"),
    _R.ACC: RegisterRow("ACC", "float", True, "rad/s^2"),
    _R.DEC: RegisterRow("DEC", "float", True, "rad/s^2"),
    _R.MAX_SPD: RegisterRow("MAX_SPD", "float", True, "rad/s"),
    _R.MST_ID: RegisterRow("MST_ID", "uint32", True, "CAN id"),
    _R.ESC_ID: RegisterRow("ESC_ID", "uint32", True, "CAN id"),
    _R.TIMEOUT: RegisterRow("TIMEOUT", "uint32", True, "50 µs"),
    _R.CTRL_MODE: RegisterRow("CTRL_MODE", "uint32", True, "enum"),
    _R.DAMP: RegisterRow("Damp", "float", False, ""),
    _R.INERTIA: RegisterRow("Inertia", "float", False, "kg m^2"),
    _R.HW_VER: RegisterRow("hw_ver", "uint32", False, ""),
    _R.SW_VER: RegisterRow("sw_ver", "uint32", False, ""),
    _R.SN: RegisterRow("SN", "uint32", False, ""),
    _R.NPP: RegisterRow("NPP", "uint32", False, ""),
    _R.RS: RegisterRow("Rs", "float", False, "ohm"),
    _R.LS: RegisterRow("Ls", "float", False, "H"),
    _R.FLUX: RegisterRow("Flux", "float", False, "Wb"),
    _R.GR: RegisterRow("Gr", "float", False, ""),
    _R.PMAX: RegisterRow("PMAX", "float", True, "rad"),
    _R.VMAX: RegisterRow("VMAX", "float", True, "rad/s"),
    _R.TMAX: RegisterRow("TMAX", "float", True, "Nm"),
    _R.I_BW: RegisterRow("I_BW", "float", True, ""),
    _R.KP_ASR: RegisterRow("KP_ASR", "float", True, ""),
    _R.KI_ASR: RegisterRow("KI_ASR", "float", True, ""),
    _R.KP_APR: RegisterRow("KP_APR", "float", True, ""),
    _R.KI_APR: RegisterRow("KI_APR", "float", True, ""),
    _R.OV_VALUE: RegisterRow("OV_Value", "float", True, "V"),
    _R.GREF: RegisterRow("GREF", "float", True, "ratio"),
    _R.DETA: RegisterRow("Deta", "float", True, ""),
    _R.V_BW: RegisterRow("V_BW", "float", True, ""),
    _R.IQ_C1: RegisterRow("IQ_c1", "float", True, ""),
    _R.VL_C1: RegisterRow("VL_c1", "float", True, ""),
    _R.CAN_BR: RegisterRow("can_br", "uint32", True, "enum"),
    _R.SUB_VER: RegisterRow("sub_ver", "uint32", False, ""),
    _R.U_OFF: RegisterRow("u_off", "float", False, ""),
    _R.V_OFF: RegisterRow("v_off", "float", False, ""),
    _R.K1: RegisterRow("k1", "float", False, ""),
    _R.K2: RegisterRow("k2", "float", False, ""),
    _R.M_OFF: RegisterRow("m_off", "float", False, ""),
    _R.DIR: RegisterRow("dir", "float", False, ""),
    _R.M_OFF_MOTOR: RegisterRow("m_off (motor side)", "float", False, ""),
    _R.IMAX: RegisterRow("Imax", "float", False, "A"),
    _R.VBUS: RegisterRow("VBus", "float", False, "V"),
    _R.TPCB: RegisterRow("Tpcb", "float", False, "°C"),
    _R.TMTR: RegisterRow("Tmtr", "float", False, "°C"),
    _R.IU_OFF: RegisterRow("Iu_off", "float", False, ""),
    _R.IV_OFF: RegisterRow("Iv_off", "float", False, ""),
    _R.IW_OFF: RegisterRow("Iw_off", "float", False, ""),
    _R.P_M: RegisterRow("p_m", "float", False, "rad"),
    _R.XOUT: RegisterRow("xout", "float", False, "rad"),
}


class RegisterRequest(NamedTuple):
    """A decoded request. `value` is None unless the request writes; `register` may be unknown."""

    motor_id: int
    opcode: int
    register: int
    value: float | int | None


class RegisterReply(NamedTuple):
    """A decoded reply; `value` in the register's unit."""

    motor_id: int
    opcode: int
    register: int
    value: float | int


def register_row(register: int) -> RegisterRow:
    """Row of a register number.

    Raises:
        ConfigError: Damiao motors have no such register.
    """
    try:
        return REGISTERS[register]
    except KeyError:
        raise ConfigError(f"no register {register}; known: {', '.join(r.name for r in Register)}") from None


def encode_read(motor_id: int, register: int) -> bytes:
    """Ask motor `motor_id` for a register. 8 bytes for identifier 0x7FF."""
    register_row(register)
    return _HEADER.pack(motor_id, Opcode.READ, register, _ZEROS)


def encode_write(motor_id: int, register: int, value: float) -> bytes:
    """Set a register in the motor's RAM; `encode_store` makes it survive a power cycle.

    Raises:
        ConfigError: unknown or read-only register, or a value it cannot hold.
    """
    row = register_row(register)
    if not row.writable:
        raise ConfigError(f"register {row.name} of motor {motor_id} is read-only")
    return _HEADER.pack(motor_id, Opcode.WRITE, register, encode_value(register, value))


def encode_store(motor_id: int) -> bytes:
    """Store all registers of the motor to flash."""
    return _HEADER.pack(motor_id, Opcode.STORE, 1, _ZEROS)


def encode_refresh(motor_id: int) -> bytes:
    """Ask for a feedback frame; commands no motion and enables nothing."""
    return _HEADER.pack(motor_id, Opcode.REFRESH, 0, _ZEROS)


def decode_request(data: bytes) -> RegisterRequest | None:
    """What a motor reads out of a 0x7FF frame, or None when it is no request."""
    if not 4 <= len(data) <= 8:
        return None
    motor_id, opcode, register, raw = _HEADER.unpack(bytes(data).ljust(8, b"\x00"))
    if opcode == Opcode.WRITE:
        if register not in REGISTERS:
            return None
        return RegisterRequest(motor_id, opcode, register, decode_value(register, raw))
    if opcode in (Opcode.READ, Opcode.STORE, Opcode.REFRESH):
        return RegisterRequest(motor_id, opcode, register, None)
    return None


def encode_reply(motor_id: int, opcode: int, register: int, value: float) -> bytes:
    """What a motor answers to a read or write: the value it holds now."""
    return _HEADER.pack(motor_id, opcode, register, encode_value(register, value))


def decode_reply(data: bytes) -> RegisterReply | None:
    """A read or write reply, or None when the frame cannot be one (then it is feedback)."""
    if len(data) != 8 or data[1] > 7 or data[2] not in (Opcode.READ, Opcode.WRITE) or data[3] not in REGISTERS:
        return None
    motor_id, opcode, register, raw = _HEADER.unpack(data)
    return RegisterReply(motor_id, opcode, register, decode_value(register, raw))


def encode_value(register: int, value: float) -> bytes:
    """Four little-endian bytes of a register's value.

    Raises:
        ConfigError: unknown register, or a value it cannot hold.
    """
    row = register_row(register)
    with contextlib.suppress(OverflowError, ValueError, TypeError, struct.error):  # too large, NaN, no number
        if row.kind == "float":
            if math.isfinite(value):
                return _FLOAT.pack(value)
        elif int(value) == value:
            return _UINT.pack(int(value))
    takes = "a finite float32" if row.kind == "float" else "an integer from 0 to 2^32 - 1"
    raise ConfigError(f"register {row.name} cannot hold {value}: it takes {takes}")


def decode_value(register: int, raw: bytes) -> float | int:
    """Value of a register's four bytes: float or int by the register's kind."""
    packer = _FLOAT if register_row(register).kind == "float" else _UINT
    value: float | int = packer.unpack(raw)[0]
    return value
