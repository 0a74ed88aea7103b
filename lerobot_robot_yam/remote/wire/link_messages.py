"""What travels between a host, the computer that has the arms, and its clients.

Every message is one frame: 8 bytes that say what it is and in which version, then a packed record; what is asked
seldom (hello, start, stop) is JSON of bounded size behind the same 8 bytes. Nothing is ever unpickled. Times are in s,
of the monotonic clock of the computer that the field names.
"""

import json
import math
import struct
import zlib
from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import Any, NamedTuple

from lerobot_robot_yam.errors import LinkError
from lerobot_robot_yam.state.records import COMMAND_DTYPE, STATE_DTYPE

VERSION = 1
LAYOUT = zlib.crc32(repr((STATE_DTYPE.descr, COMMAND_DTYPE.descr)).encode())  # of the records inside
MOST_BYTES = 1 << 16  # of a message to the host
MOST_ANSWER_BYTES = 1 << 20  # of one to a client: a hello has the options of four arms
_MOST_TEXT = 400
_MOST_ARMS = 8

_HEAD = struct.Struct("<2sBBI")  # magic, version, kind, layout
_MAGIC = b"YR"
_COMMAND = struct.Struct("<QQB")
_BEAT = struct.Struct("<QQdB")
_ECHO = struct.Struct("<dddB")
_STATES = struct.Struct("<QBQB")
_ARM = struct.Struct("<BQH")
_TEXTS_AT = STATE_DTYPE.fields["refusal"][1]  # type: ignore[index]
_NO_TEXTS = bytes(STATE_DTYPE.itemsize - _TEXTS_AT)


class OtherVersionError(LinkError):
    """A message of another version of this package."""


class Kind(IntEnum):
    """What a message is."""

    ASK = 1
    ANSWER = 2
    COMMAND = 3
    BEAT = 4
    ECHO = 5
    STATES = 6


class Command(NamedTuple):
    """A client's command record for one arm, with all times by the host's clock."""

    session: int
    sequence: int
    arm: int  # its number in the host's hello
    record: bytes | bytearray  # of COMMAND_DTYPE


class Beat(NamedTuple):
    """A sign of life of a client, ten times a second; the host answers with an `Echo`."""

    session: int  # 0: it only watches
    machine: int  # the client's computer and user, see `machine_number`
    sent_s: float  # the client's clock
    stopped: int  # whether the emergency stop is latched there


class Echo(NamedTuple):
    """The host's answer to a beat."""

    sent_s: float  # of the beat, as the client's clock had it
    received_s: float  # the host's clock
    answered_s: float  # the host's clock
    held: int  # whether the beat's session has arms; one that has had some and has none any more has lost them


class ArmNews(NamedTuple):
    """The state of one arm."""

    arm: int
    answered: int  # newest request of its client that was carried out or refused
    record: bytes  # of STATE_DTYPE, the host's clock


class States(NamedTuple):
    """The newest states of all arms that run."""

    run: int  # a random number of this run of the host
    stopped: int  # whether the emergency stop is latched on the host
    stopped_by: int  # the machine whose stop that is, the host or a client's
    arms: Sequence[ArmNews]


def _head(kind: Kind) -> bytes:
    return _HEAD.pack(_MAGIC, VERSION, kind, LAYOUT)


_HEADS = {kind: _head(kind) for kind in Kind}


def kind_of(message: bytes) -> Kind:
    """What a message is. Raises LinkError: none of ours, or of another version."""
    if len(message) < _HEAD.size:
        raise LinkError("a message is too short")
    magic, version, kind, layout = _HEAD.unpack_from(message)
    if magic != _MAGIC:
        raise LinkError("a message is not of this protocol")
    if (version, layout) != (VERSION, LAYOUT):
        raise OtherVersionError(
            "the other computer has another version of lerobot_robot_yam (its messages differ); install the same "
            "version on both"
        )
    try:
        return Kind(kind)
    except ValueError as error:
        raise LinkError(f"a message is of no known kind ({kind})") from error


def pack_ask(number: int, op: str, **fields: Any) -> bytes:
    """A question. `number` comes back with its answer."""
    return _HEADS[Kind.ASK] + json.dumps({"number": number, "op": op, **fields}).encode()


def pack_answer(number: int, fields: Mapping[str, Any]) -> bytes:
    """The answer to a question."""
    return _HEADS[Kind.ANSWER] + json.dumps({"number": number, **fields}).encode()


def unpack_json(message: bytes) -> dict[str, Any]:
    """Fields of a question or an answer. Raises LinkError: not such JSON."""

    def refuse(constant: str) -> float:
        raise ValueError(f"{constant} is no number")

    try:
        found = json.loads(message[_HEAD.size :], parse_constant=refuse)
    except (ValueError, RecursionError) as error:
        raise LinkError(f"a message cannot be read: {error}") from error
    if not isinstance(found, dict) or type(found.get("number")) is not int:
        raise LinkError("a message has no number")
    return found


def text_of(fields: Mapping[str, Any], name: str) -> str:
    """A short text. Raises LinkError: it is none."""
    value = fields.get(name)
    if not isinstance(value, str) or not value.isprintable() or not 0 < len(value) <= _MOST_TEXT:
        raise LinkError(f"{name} is not a short text")
    return value


def number_of(fields: Mapping[str, Any], name: str) -> int:
    """A number of 64 bits that is not 0. Raises LinkError: it is none."""
    value = fields.get(name)
    if type(value) is not int or not 0 < value < 1 << 64:
        raise LinkError(f"{name} is not a number of 64 bits")
    return value


def pack_command(command: Command) -> bytes:
    return _HEADS[Kind.COMMAND] + _COMMAND.pack(*command[:3]) + command.record


def unpack_command(message: bytes) -> Command:
    """Raises LinkError: wrong size."""
    if len(message) != _HEAD.size + _COMMAND.size + COMMAND_DTYPE.itemsize:
        raise LinkError("a command has the wrong size")
    session, sequence, arm = _COMMAND.unpack_from(message, _HEAD.size)
    return Command(session, sequence, arm, message[_HEAD.size + _COMMAND.size :])


def pack_beat(beat: Beat) -> bytes:
    return _HEADS[Kind.BEAT] + _BEAT.pack(*beat)


def unpack_beat(message: bytes) -> Beat:
    """Raises LinkError: wrong size, or a time that is not finite."""
    if len(message) != _HEAD.size + _BEAT.size:
        raise LinkError("a beat has the wrong size")
    beat = Beat(*_BEAT.unpack_from(message, _HEAD.size))
    if not math.isfinite(beat.sent_s):
        raise LinkError("a beat has no time")
    return beat


def pack_echo(echo: Echo) -> bytes:
    return _HEADS[Kind.ECHO] + _ECHO.pack(*echo)


def unpack_echo(message: bytes) -> Echo:
    """Raises LinkError: wrong size, or a time that is not finite."""
    if len(message) != _HEAD.size + _ECHO.size:
        raise LinkError("an echo has the wrong size")
    echo = Echo(*_ECHO.unpack_from(message, _HEAD.size))
    if not all(map(math.isfinite, echo[:3])):
        raise LinkError("an echo has no time")
    return echo


def pack_states(states: States) -> bytes:
    """The texts at the end of a record do not travel where they are empty."""
    parts = [_HEADS[Kind.STATES], _STATES.pack(*states[:3], len(states.arms))]
    for arm, answered, record in states.arms:
        if record.endswith(_NO_TEXTS):
            record = record[:_TEXTS_AT]
        parts += [_ARM.pack(arm, answered, len(record)), record]
    return b"".join(parts)


def unpack_states(message: bytes) -> States:
    """Raises LinkError: something else, or wrong sizes."""
    if not message.startswith(_HEADS[Kind.STATES]) and kind_of(message) is not Kind.STATES:
        raise LinkError("what comes is no state")
    try:
        at = _HEAD.size + _STATES.size
        run, stopped, stopped_by, count = _STATES.unpack_from(message, _HEAD.size)
        if count > _MOST_ARMS:
            raise LinkError("a state message has too many arms")
        arms = []
        for _ in range(count):
            arm, answered, size = _ARM.unpack_from(message, at)
            at += _ARM.size
            record = message[at : at + size]
            at += size
            if len(record) != size or size > STATE_DTYPE.itemsize:
                raise LinkError("a state has the wrong size")
            arms.append(ArmNews(arm, answered, record.ljust(STATE_DTYPE.itemsize, b"\0")))
    except struct.error as error:
        raise LinkError(f"a state message is too short: {error}") from error
    if at != len(message):
        raise LinkError("a state message is too long")
    return States(run, stopped, stopped_by, arms)
