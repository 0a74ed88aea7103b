"""Allowed values of registers. Source: the register tables in DM_Control_Python and python-damiao-driver."""

import math
from typing import NamedTuple

from lerobot_robot_yam.damiao.registers import REGISTERS, Register, encode_value
from lerobot_robot_yam.errors import ConfigError

_MOST_ID = 0x7FF
_SMALLEST = 1e-6  # minimum of registers whose values must be above zero


class _Range(NamedTuple):
    least: float
    most: float
    words: str


RANGES: dict[Register, _Range] = {
    Register.UV_VALUE: _Range(10.0, math.inf, "at least 10"),
    Register.KT_VALUE: _Range(0.0, math.inf, "at least 0"),
    Register.OT_VALUE: _Range(80.0, 199.9, "from 80 to below 200"),
    Register.OC_VALUE: _Range(_SMALLEST, 1.0 - _SMALLEST, "between 0 and 1"),
    Register.ACC: _Range(_SMALLEST, math.inf, "above 0"),
    Register.DEC: _Range(-math.inf, -_SMALLEST, "below 0"),
    Register.MAX_SPD: _Range(_SMALLEST, math.inf, "above 0"),
    Register.MST_ID: _Range(0, _MOST_ID, "from 0 to 2047"),
    Register.ESC_ID: _Range(0, _MOST_ID, "from 0 to 2047"),
    Register.CTRL_MODE: _Range(1, 4, "1 MIT, 2 position-velocity, 3 velocity or 4 force-position"),
    Register.PMAX: _Range(_SMALLEST, math.inf, "above 0"),
    Register.VMAX: _Range(_SMALLEST, math.inf, "above 0"),
    Register.TMAX: _Range(_SMALLEST, math.inf, "above 0"),
    Register.I_BW: _Range(100.0, 10_000.0, "from 100 to 10000"),
    Register.KP_ASR: _Range(0.0, math.inf, "at least 0"),
    Register.KI_ASR: _Range(0.0, math.inf, "at least 0"),
    Register.KP_APR: _Range(0.0, math.inf, "at least 0"),
    Register.KI_APR: _Range(0.0, math.inf, "at least 0"),
    Register.GREF: _Range(_SMALLEST, 1.0, "above 0, at most 1"),
    Register.DETA: _Range(1.0, 30.0, "from 1 to 30"),
    Register.V_BW: _Range(0.0, 500.0, "from 0 to 500"),
    Register.IQ_C1: _Range(100.0, 10_000.0, "from 100 to 10000"),
    Register.VL_C1: _Range(0.0, 10_000.0, "from 0 to 10000"),
    Register.CAN_BR: _Range(0, 4, "0 to 4"),
}


def register_named(name: str) -> Register:
    """Return the register with this name (in any case) or number. Raises ConfigError: there is no such register."""
    try:
        return REGISTERS[int(name)] if name.isdecimal() else Register[name.upper()]
    except KeyError:
        raise ConfigError(f"no register {name!r}; known: {', '.join(r.name for r in Register)}") from None


def check_value(register: Register, value: float) -> None:
    """Check that a value is allowed in a register.

    Raises:
        ConfigError: the register is read-only, cannot represent the value, or does not allow it.
    """
    if not register.writable:
        raise ConfigError(f"register {register.name} is read-only")
    encode_value(register, value)
    least, most, words = RANGES.get(register, _Range(-math.inf, math.inf, ""))
    if not least <= value <= most:
        unit = f" {register.unit}" if register.unit not in ("", "enum", "CAN id") else ""
        raise ConfigError(f"register {register.name} takes values {words}{unit}, not {value:g}")
