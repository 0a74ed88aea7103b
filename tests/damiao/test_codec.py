import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lerobot_robot_yam.damiao import codec
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.tables import MOTOR_TYPES, VELOCITY_OFFSET, motor_type
from lerobot_robot_yam.errors import ActionError, ConfigError
from tests.support.desk_bus import encode_feedback
from tests.support.paths import GOLDEN as GOLDEN_FILES

GOLDEN = json.loads((GOLDEN_FILES / "mit_frames.json").read_text())
TYPES = sorted(MOTOR_TYPES)
ROW = ["DM4340", "DM4310", "DM3507"]
any_value = st.floats(-200, 200)


def test_mit_commands_match_the_vendor_bit_by_bit():
    assert len(GOLDEN["mit_commands"]) == 200
    for case in GOLDEN["mit_commands"]:
        frame = codec.encode_mit(case["motor_type"], case["pos"], case["vel"], case["kp"], case["kd"], case["torque"])
        assert frame.hex() == case["frame_hex"], case


def test_feedback_matches_the_vendor_exactly():
    assert len(GOLDEN["feedback"]) == 200
    for case in GOLDEN["feedback"]:
        feedback = codec.decode_feedback(case["motor_type"], bytes.fromhex(case["frame_hex"]))
        assert feedback == (
            case["motor_id"],
            case["error_code"],
            case["position"],
            case["velocity"],
            case["torque"],
            case["temp_mosfet"],
            case["temp_rotor"],
        )


def test_velocity_commands_match_the_vendor():
    for case in GOLDEN["velocity_commands"]:
        frame = bytes.fromhex(case["frame_hex"])
        assert case["arbitration_id"] == VELOCITY_OFFSET + case["motor_id"]
        assert codec.decode_position_velocity(frame) == (pytest.approx(case["vel"], rel=1e-6), 0.0)
        assert codec.encode_velocity(case["vel"]) == frame


@pytest.mark.parametrize("name", TYPES)
@given(position=any_value, velocity=any_value, kp=st.floats(-1, 600), kd=st.floats(-1, 6), torque=any_value)
@settings(max_examples=30, deadline=None)
def test_a_command_survives_up_to_one_code(name, position, velocity, kp, kd, torque):
    row = motor_type(name)
    back = codec.decode_mit(name, codec.encode_mit(name, position, velocity, kp, kd, torque))

    def clamped(x, low, high):
        return min(max(x, low), high)

    for value, got, low, high, bits in (
        (position, back.position, -row.position_max_rad, row.position_max_rad, 16),
        (velocity, back.velocity, -row.velocity_max_rad_s, row.velocity_max_rad_s, 12),
        (kp, back.kp, 0.0, row.kp_max, 12),
        (kd, back.kd, 0.0, row.kd_max, 12),
        (torque, back.torque, -row.torque_max_nm, row.torque_max_nm, 12),
    ):
        step = (high - low) / (2**bits - 1)
        error = clamped(value, low, high) - got
        assert -1e-9 <= error < step + 1e-9  # truncated, never rounded up


@pytest.mark.parametrize("name", TYPES)
@given(
    motor_id=st.integers(0, 40),
    fault=st.integers(0, 15),
    position=any_value,
    temperature=st.floats(-40, 300),
)
@settings(max_examples=30, deadline=None)
def test_feedback_of_the_rig_is_what_a_driver_decodes(name, motor_id, fault, position, temperature):
    row = motor_type(name)
    frame = encode_feedback(name, motor_id, fault, position, 0.0, 1.0, temperature, 31)
    feedback = codec.decode_feedback(name, frame)
    assert feedback.motor_id == motor_id & 0xF
    assert feedback.fault == fault
    limited = min(max(position, -row.position_max_rad), row.position_max_rad)
    assert feedback.position == pytest.approx(limited, abs=2 * row.position_max_rad / 65535)
    assert feedback.torque == pytest.approx(1.0, abs=2 * row.torque_max_nm / 4095)
    assert feedback.temp_mos == min(max(int(temperature), 0), 255)
    assert feedback.temp_rotor == 31


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("field", ["position", "velocity", "kp", "kd", "torque"])
def test_values_that_are_no_numbers_are_refused_by_name(bad, field):
    values = dict.fromkeys(("position", "velocity", "kp", "kd", "torque"), 0.0)
    with pytest.raises(ActionError, match=field):
        codec.encode_mit("DM4310", **{**values, field: bad})


def test_opposite_infinities_do_not_cancel():
    with pytest.raises(ActionError):
        codec.encode_mit("DM4310", math.inf, -math.inf, 0.0, 0.0, 0.0)


def test_huge_finite_values_are_clamped():
    huge = codec.encode_mit("DM4310", 1.7e308, 1.7e308, 1.7e308, 0.0, -1.7e308)
    assert huge == codec.encode_mit("DM4310", 12.5, 30.0, 500.0, 0.0, -10.0)


@pytest.mark.parametrize("code", range(0xFB, 0x100))
def test_no_command_can_be_read_as_a_special_command(code):
    torque = (0xF00 | code) * 20.0 / 4095 - 10.0 + 1e-6
    frame = codec.encode_mit("DM4310", 99.0, 99.0, 999.0, 99.0, torque)
    assert frame not in codec.SPECIAL_OF
    assert codec.decode_mit("DM4310", frame).torque == pytest.approx(torque, abs=0.03)


def test_special_commands_are_told_from_ordinary_ones():
    assert {command: command.value.hex() for command in SpecialCommand} == {
        SpecialCommand.ENABLE: "fffffffffffffffc",
        SpecialCommand.DISABLE: "fffffffffffffffd",
        SpecialCommand.ZERO: "fffffffffffffffe",
        SpecialCommand.CLEAR: "fffffffffffffffb",
    }
    for command in SpecialCommand:
        assert codec.SPECIAL_OF[command.value] is command
    assert bytes(8) not in codec.SPECIAL_OF


def test_position_velocity_frame():
    assert codec.decode_position_velocity(bytes.fromhex("0000c03f000000c0")) == (1.5, -2.0)
    assert codec.encode_position_velocity(1.5, -2.0) == bytes.fromhex("0000c03f000000c0")
    with pytest.raises(ActionError, match="speed of a motor command is nan"):
        codec.encode_position_velocity(1.5, float("nan"))


@pytest.mark.parametrize(
    "call",
    [
        lambda: codec.encode_mit("DM9999", 0, 0, 0, 0, 0),
        lambda: codec.decode_mit("DM9999", bytes(8)),
        lambda: codec.decode_feedback("DM9999", bytes(8)),
        lambda: encode_feedback("DM9999", 1, 1, 0, 0, 0, 0, 0),
    ],
)
def test_unknown_motor_type_lists_the_known_ones(call):
    with pytest.raises(ConfigError, match="DM9999.*DM4310.*DM8009"):
        call()


def torque_at(rows, q, make_up):
    """What motors that stand still at q (n,) make of the packed commands, Nm, with the gains really sent."""
    packed = [
        codec.pack_mit(codec.ranges_of(kind), *row, make_up) for kind, row in zip(ROW, rows.tolist(), strict=True)
    ]
    sent = [codec.decode_mit(kind, data) for kind, data in zip(ROW, packed, strict=True)]
    return np.array([c.kp * (c.position - at) + c.kd * c.velocity + c.torque for c, at in zip(sent, q, strict=True)])


def test_the_motors_torque_comes_closer_to_the_wanted_one():
    rng = np.random.default_rng(0)
    plain, better = [], []
    for _ in range(300):
        rows = np.column_stack(
            (rng.uniform(-3, 3, 3), np.zeros(3), [80.0, 10.0, 10.0], [5.0, 1.5, 0.3], rng.uniform(-2, 2, 3))
        )
        wanted = rows[:, 3] * rows[:, 1] + rows[:, 4]  # standing at the set-point
        plain.append(torque_at(rows, rows[:, 0], make_up=False) - wanted)
        better.append(torque_at(rows, rows[:, 0], make_up=True) - wanted)
    assert np.abs(np.mean(plain, axis=0)).max() > 0.01  # truncation is a bias, not noise
    assert np.abs(np.mean(better, axis=0)).max() < 0.002
    steps = np.array([2 * 28.0, 2 * 10.0, 2 * 5.0]) / 4095
    assert (np.abs(better).max(axis=0) < 0.75 * steps).all()
