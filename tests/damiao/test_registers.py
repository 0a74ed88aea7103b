import math

import pytest

from lerobot_robot_yam.damiao import registers
from lerobot_robot_yam.damiao.registers import REGISTERS, Opcode, Register
from lerobot_robot_yam.errors import ConfigError
from tests.support.desk_bus import encode_feedback


@pytest.mark.parametrize(
    ("frame", "expected"),
    [
        (registers.encode_read(1, Register.TIMEOUT), "0100330900000000"),
        (registers.encode_write(1, Register.TIMEOUT, 8000), "01005509401f0000"),
        (registers.encode_write(0x102, Register.PMAX, 12.5), "0201551500004841"),
        (registers.encode_store(7), "0700aa0100000000"),
        (registers.encode_refresh(7), "0700cc0000000000"),
        (registers.encode_reply(3, Opcode.READ, Register.MST_ID, 19), "0300330713000000"),
    ],
)
def test_frames_as_documented(frame, expected):
    assert frame.hex() == expected


def test_the_table_is_complete():
    assert set(REGISTERS) == set(Register)
    integers = {number for number, row in REGISTERS.items() if row.kind == "uint32"}
    assert integers == {7, 8, 9, 10, 13, 14, 15, 16, 35, 36}
    read_only = {number for number, row in REGISTERS.items() if not row.writable}
    assert read_only == {*range(11, 21), 36, *range(50, 57), *range(59, 66), 80, 81}


@pytest.mark.parametrize("register", Register)
def test_reply_round_trip(register):
    value = 1234 if REGISTERS[register].kind == "uint32" else 0.5
    reply = registers.decode_reply(registers.encode_reply(7, Opcode.READ, register, value))
    assert reply == (7, Opcode.READ, register, value)
    assert type(reply.value) is type(value)


def test_requests_are_read_back():
    assert registers.decode_request(registers.encode_read(2, Register.PMAX)) == (2, Opcode.READ, 21, None)
    assert registers.decode_request(registers.encode_write(2, Register.PMAX, 3.5)) == (
        2,
        Opcode.WRITE,
        21,
        3.5,
    )
    assert registers.decode_request(registers.encode_store(2)) == (2, Opcode.STORE, 1, None)
    assert registers.decode_request(registers.encode_refresh(2)) == (2, Opcode.REFRESH, 0, None)


@pytest.mark.parametrize(
    "data",
    [b"", b"\x01\x00\x33", bytes(8), bytes((1, 0, 0x55, 200, 0, 0, 0, 0)), bytes((1, 0, 0x44, 9) + (0,) * 4)],
)
def test_what_is_no_request_is_ignored(data):
    assert registers.decode_request(data) is None


def test_a_short_refresh_is_accepted():
    assert registers.decode_request(bytes((5, 0, 0xCC, 0))) == (5, Opcode.REFRESH, 0, None)


def test_feedback_is_no_reply():
    assert registers.decode_reply(encode_feedback("DM4310", 1, 1, 0.0, 0.0, 0.0, 30, 30)) is None
    assert registers.decode_reply(b"\x01\x00\x33") is None


@pytest.mark.parametrize("value", [-1, 2**32, 1.5, math.nan])
def test_values_that_an_integer_register_cannot_hold(value):
    with pytest.raises(ConfigError, match="TIMEOUT"):
        registers.encode_write(1, Register.TIMEOUT, value)


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e39])
def test_values_that_a_float_register_cannot_hold(value):
    with pytest.raises(ConfigError, match="PMAX"):
        registers.encode_write(1, Register.PMAX, value)


def test_read_only_and_unknown_registers_are_refused():
    with pytest.raises(ConfigError, match="SW_VER.*read-only"):
        registers.encode_write(1, Register.SW_VER, 1)
    with pytest.raises(ConfigError, match="no register 40"):
        registers.encode_read(1, 40)
