"""Messages come out as they went in, and whatever else arrives is refused by a LinkError, nothing else."""

import math

import numpy as np
import pytest
from hypothesis import strategies as st

from lerobot_robot_yam.errors import LinkError
from lerobot_robot_yam.remote import link_messages as wire
from lerobot_robot_yam.state.base_records import BASE_COMMAND_DTYPE, BASE_STATE_DTYPE
from lerobot_robot_yam.state.records import COMMAND_DTYPE, STATE_DTYPE
from tests.support.cases import for_all

BEAT = wire.Beat(5, "9f", 1.25, True)
ECHO = wire.Echo(1.0, 2.0, 2.5, True)
COMMAND = wire.Command(2**63, 7, 3, bytes(range(256)) * 4)
MESSAGES = [
    wire.Question(3, "start", group="robot", session=2**62, who="a"),
    wire.Answer(3, {"landed": True, "arms": [1.5, None]}),
    wire.Command(2**63, 7, 3, np.zeros((), COMMAND_DTYPE).tobytes()),
    wire.Command(2**63, 7, 3, np.zeros((), BASE_COMMAND_DTYPE).tobytes()),
    BEAT,
    ECHO,
    wire.States(2**62, "6", True, ["5f"], [(0, b"quiet"), (1, np.zeros((), STATE_DTYPE).tobytes())]),
]


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: type(message).__name__)
def test_messages_come_out_as_they_went_in(message):
    assert wire.decode(wire.encode(message)) == message


def test_another_version_is_named():
    message = bytearray(wire.encode(BEAT))
    message[2] += 1
    with pytest.raises(LinkError, match="install the same version on both"):
        wire.decode(bytes(message))


@pytest.mark.parametrize(
    "message",
    [
        wire.Beat(5, "9f", math.nan, False),
        wire.Beat(5, "9f", math.inf, False),
        wire.Beat(5, "\x1b[2J", 1.0, False),
        wire.Beat(-1, "9f", 1.0, False),
        wire.Echo(1.0, 2.0, -math.inf, True),
        wire.Question(3, "pickle"),
        wire.Question(3, "start", session="1"),
        wire.Command(1, 1, 1, b"short"),
        wire.States(1, "", False, [], [(0, bytes(max(STATE_DTYPE.itemsize, BASE_STATE_DTYPE.itemsize) + 1))]),
    ],
    ids=repr,
)
def test_values_that_make_no_sense_are_refused(message):
    with pytest.raises(LinkError, match="cannot be read"):
        wire.decode(wire.encode(message))


@pytest.mark.parametrize("data", [b"", b"\x92\xa6Answer\xff", b"\x91" * 60000, b"\x93\xa6Answer\x01" + b"\x91" * 60000])
def test_what_is_no_record_is_refused(data):
    with pytest.raises(LinkError):
        wire.decode(wire.HEAD + data)
    with pytest.raises(LinkError):
        wire.decode(data)


def read_or_refused(data):
    try:
        wire.decode(data)
    except LinkError:
        pass


@for_all(rest=st.binary(max_size=2 * STATE_DTYPE.itemsize))
def test_random_bytes_are_read_or_refused(rest):
    read_or_refused(wire.HEAD + rest)


@for_all(message=st.sampled_from(MESSAGES), at=st.integers(0, 1 << 12), byte=st.integers(1, 255))
def test_a_flipped_byte_is_read_or_refused(message, at, byte):
    data = bytearray(wire.encode(message))
    data[at % len(data)] ^= byte
    read_or_refused(bytes(data))
