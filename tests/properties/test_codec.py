"""What a command, a feedback frame or a report can say survives packing; what it cannot is clamped or refused."""

import math

import numpy as np
import pytest
from hypothesis import strategies as st

from lerobot_robot_yam.damiao import codec, handle_encoder
from lerobot_robot_yam.damiao.handle_encoder import HandleEncoder
from lerobot_robot_yam.damiao.registers import decode_reply, decode_request
from lerobot_robot_yam.damiao.tables import MOTOR_TYPES
from lerobot_robot_yam.errors import ActionError, BusError
from tests.support.cases import for_all, numbers
from tests.support.desk_bus import encode_feedback
from tests.support.frames import payloads

# Sums of numpy's small types overflow with a warning; what is returned or raised is what counts.
pytestmark = pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid value")

KINDS = st.sampled_from(sorted(MOTOR_TYPES))
MIT_FIELDS = ("position", "velocity", "kp", "kd", "torque")


def mit_ranges(kind):
    """(5, 3): least, largest and one quantum of what a frame can say."""
    row = MOTOR_TYPES[kind]
    ends = [(-row.position_max_rad, row.position_max_rad, 16), (-row.velocity_max_rad_s, row.velocity_max_rad_s, 12)]
    ends += [(0.0, row.kp_max, 12), (0.0, row.kd_max, 12), (-row.torque_max_nm, row.torque_max_nm, 12)]
    return [(low, high, (high - low) / (2**bits - 1)) for low, high, bits in ends]


def representable(value):
    """Whether a number is a finite float."""
    try:
        return math.isfinite(float(value))
    except OverflowError:  # 10**400
        return False


SHARES = st.lists(st.floats(0.0, 1.0), min_size=5, max_size=5)
SATURATED = st.floats(0.997, 1.0).map(lambda share: [1.0, 1.0, 1.0, 1.0, share])  # special commands are near


@for_all(kind=KINDS, shares=SHARES | SATURATED)
def test_a_command_survives_packing_to_one_quantum(kind, shares):
    ranges = mit_ranges(kind)
    values = [low + share * (high - low) for share, (low, high, _) in zip(shares, ranges, strict=True)]
    data = codec.encode_mit(kind, *values)
    assert len(data) == 8 and data not in codec.SPECIAL_OF
    steps = [1, 1, 1, 1, 5 if min(shares[:4]) == 1.0 else 1]  # all saturated: the torque steps over special commands
    for name, value, got, step, row in zip(
        MIT_FIELDS, values, codec.decode_mit(kind, data), steps, ranges, strict=True
    ):
        low, high, quantum = row
        assert low - 1e-9 <= got <= high + 1e-9, name
        assert abs(value - got) <= step * quantum * (1 + 1e-9), name


@for_all(kind=KINDS, values=st.lists(numbers(), min_size=5, max_size=5))
def test_a_command_is_clamped_or_refused(kind, values):
    if not all(representable(value) for value in values):
        with pytest.raises(ActionError):
            codec.encode_mit(kind, *values)
        return
    got = codec.decode_mit(kind, codec.encode_mit(kind, *values))
    for name, value, there, (low, high, quantum) in zip(MIT_FIELDS, values, got, mit_ranges(kind), strict=True):
        clamped = min(max(value, low), high)
        assert abs(float(clamped) - there) <= 5 * quantum * (1 + 1e-9), name


@for_all(kind=KINDS, ident=st.integers(), fault=st.integers(), values=st.lists(numbers(), min_size=5, max_size=5))
def test_feedback_can_say_any_state(kind, ident, fault, values):
    if not all(representable(value) for value in values):
        return
    data = encode_feedback(kind, ident, fault, *map(float, values))
    got = codec.decode_feedback(kind, data)
    assert (got.motor_id, got.fault) == (ident & 0xF, fault & 0xF)
    assert 0 <= got.temp_mos <= 255 and 0 <= got.temp_rotor <= 255
    for value, there, row in zip(values[:3], got[2:5], [mit_ranges(kind)[i] for i in (0, 1, 4)], strict=True):
        low, high, quantum = row
        assert abs(float(min(max(value, low), high)) - there) <= quantum * (1 + 1e-9)


@for_all(kind=KINDS, data=payloads())
def test_every_decoder_takes_any_bytes(kind, data):
    decoders = {
        "feedback": lambda: codec.decode_feedback(kind, data),
        "mit": lambda: codec.decode_mit(kind, data),
        "position_velocity": lambda: codec.decode_position_velocity(data),
        "report": lambda: handle_encoder.decode_report(data),
    }
    sizes = dict.fromkeys(decoders, 8) | {"report": 6}
    for name, decode in decoders.items():
        if len(data) == sizes[name]:
            values = decode()
            if name in ("feedback", "mit", "report"):
                assert np.isfinite(np.hstack(values)).all(), name
        else:
            with pytest.raises(BusError):
                decode()
    for decode in (decode_reply, decode_request, handle_encoder.decode_version):
        decode(data)  # None, or what it says; never an error
    byte = handle_encoder.decode_eeprom_byte(data)
    assert byte is None or 0 <= byte <= 255


@for_all(data=st.binary(min_size=6, max_size=6), stamp=st.floats(0, 1e9))
def test_any_report_of_the_handle_is_a_trigger(data, stamp):
    handle = HandleEncoder()
    assert handle.accept(data, stamp)
    assert 0.0 <= handle.report.trigger <= 1.0
    assert math.isfinite(handle.report.position_rad) and math.isfinite(handle.report.velocity_rad_s)
    again = handle_encoder.decode_report(
        handle_encoder.encode_report(handle.report.position_rad, handle.report.velocity_rad_s, handle.report.buttons)
    )
    assert again == handle.report
