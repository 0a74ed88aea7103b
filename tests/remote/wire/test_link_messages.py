"""Messages come out as they went in, and whatever else arrives is refused by a LinkError, nothing else."""

import math
import os

import numpy as np
import pytest
from hypothesis import strategies as st

from lerobot_robot_yam.errors import LinkError
from lerobot_robot_yam.remote.wire import link_messages as wire
from lerobot_robot_yam.state.records import COMMAND_DTYPE, STATE_DTYPE
from tests.support.cases import for_all

UNPACK = {
    wire.Kind.ASK: wire.unpack_json,
    wire.Kind.ANSWER: wire.unpack_json,
    wire.Kind.COMMAND: wire.unpack_command,
    wire.Kind.BEAT: wire.unpack_beat,
    wire.Kind.ECHO: wire.unpack_echo,
    wire.Kind.STATES: wire.unpack_states,
}
COMMAND = wire.Command(2**63, 7, 3, os.urandom(COMMAND_DTYPE.itemsize))
BEAT = wire.Beat(5, 9, 1.25, 1)
ECHO = wire.Echo(1.0, 2.0, 2.5, 1)


def states():
    quiet, speaking = np.zeros(2, STATE_DTYPE)
    speaking["message"], speaking["q"] = b"joint 3 is hot", np.arange(len(speaking["q"]))
    return wire.States(2**63, 1, 6, [wire.ArmNews(0, 1, quiet.tobytes()), wire.ArmNews(1, 2, speaking.tobytes())])


PACKED = {
    wire.Kind.ASK: wire.pack_ask(3, "hello", who="a"),
    wire.Kind.ANSWER: wire.pack_answer(3, {"landed": True}),
    wire.Kind.COMMAND: wire.pack_command(COMMAND),
    wire.Kind.BEAT: wire.pack_beat(BEAT),
    wire.Kind.ECHO: wire.pack_echo(ECHO),
    wire.Kind.STATES: wire.pack_states(states()),
}


def test_messages_come_out_as_they_went_in():
    assert {kind: wire.kind_of(message) for kind, message in PACKED.items()} == {kind: kind for kind in wire.Kind}
    assert wire.unpack_json(PACKED[wire.Kind.ASK]) == {"number": 3, "op": "hello", "who": "a"}
    assert wire.unpack_json(PACKED[wire.Kind.ANSWER]) == {"number": 3, "landed": True}
    assert wire.unpack_command(PACKED[wire.Kind.COMMAND]) == COMMAND
    assert wire.unpack_beat(PACKED[wire.Kind.BEAT]) == BEAT and wire.unpack_echo(PACKED[wire.Kind.ECHO]) == ECHO
    assert wire.unpack_states(PACKED[wire.Kind.STATES]) == states()


def test_texts_travel_only_where_there_are_some():
    quiet, speaking = (wire.pack_states(states()._replace(arms=[arm])) for arm in states().arms)
    assert len(quiet) < STATE_DTYPE.itemsize - 700 and len(speaking) > STATE_DTYPE.itemsize


def test_another_version_is_named():
    message = bytearray(PACKED[wire.Kind.BEAT])
    message[2] += 1
    with pytest.raises(LinkError, match="install the same version on both"):
        wire.kind_of(bytes(message))


def test_times_that_are_none_are_refused():
    for value in (math.nan, math.inf):
        with pytest.raises(LinkError, match="no time"):
            wire.unpack_beat(wire.pack_beat(BEAT._replace(sent_s=value)))
        with pytest.raises(LinkError, match="no time"):
            wire.unpack_echo(wire.pack_echo(ECHO._replace(answered_s=value)))


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"[]",
        b"{}",
        b'{"number": true}',
        b'{"number": 1.0}',
        b'{"number": NaN}',
        b"[" * 60000,
        b"\xff",
        b"1" * 9999,
    ],
)
def test_json_that_is_no_question_is_refused(text):
    with pytest.raises(LinkError):
        wire.unpack_json(PACKED[wire.Kind.ASK][:8] + text)


@for_all(kind=st.sampled_from(list(wire.Kind)), rest=st.binary(max_size=2 * STATE_DTYPE.itemsize))
def test_random_bytes_are_read_or_refused(kind, rest):
    message = PACKED[kind][:8] + rest
    try:
        UNPACK[wire.kind_of(message)](message)
    except LinkError:
        pass


@for_all(kind=st.sampled_from(list(wire.Kind)), at=st.integers(0, 1 << 12), byte=st.integers(1, 255))
def test_a_flipped_byte_is_read_or_refused(kind, at, byte):
    message = bytearray(PACKED[kind])
    message[at % len(message)] ^= byte
    try:
        UNPACK[wire.kind_of(bytes(message))](bytes(message))
    except LinkError:
        pass


@pytest.mark.parametrize("name, value", [("session", 0), ("session", -1), ("session", 1 << 64), ("session", "1")])
def test_a_session_is_a_number(name, value):
    with pytest.raises(LinkError):
        wire.number_of({name: value}, name)


@pytest.mark.parametrize("value", ["", "a\nb", "x" * 401, None, 3, ["a"]])
def test_a_text_is_short_and_printable(value):
    with pytest.raises(LinkError):
        wire.text_of({"who": value}, "who")
