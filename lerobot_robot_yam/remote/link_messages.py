"""Messages between a host (the computer with the arms) and its clients.

A message is one frame: 8 bytes with the version, then a record of one of these types in msgpack. msgspec decodes only
these types; nothing is ever unpickled. Times are in s, of the monotonic clock named in the field's comment.
"""

import struct
import zlib
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from lerobot_robot_yam.errors import LinkError
from lerobot_robot_yam.state.base_records import BASE_COMMAND_DTYPE, BASE_STATE_DTYPE
from lerobot_robot_yam.state.records import COMMAND_DTYPE, STATE_DTYPE

MOST_BYTES = 1 << 16  # maximum size of a message to the host, and of `States`, bytes
# maximum size of any other message to a client, bytes: a reply to hello has the options of four arms
MOST_ANSWER_BYTES = 1 << 20
_MAGIC, _VERSION = b"YR", 4
_STATES, _COMMANDS = (STATE_DTYPE, BASE_STATE_DTYPE), (COMMAND_DTYPE, BASE_COMMAND_DTYPE)
# checksum of the layout of the records
_LAYOUT = zlib.crc32(repr([dtype.descr for dtype in (*_STATES, *_COMMANDS)]).encode())
_STATE_BYTES, _COMMAND_BYTES = ([dtype.itemsize for dtype in dtypes] for dtypes in (_STATES, _COMMANDS))
HEAD = struct.pack("<2sHI", _MAGIC, _VERSION, _LAYOUT)

Number = Annotated[int, Meta(ge=0)]
Time = Annotated[float, Meta(ge=0.0, le=1e12)]  # finite time, s
Machine = Annotated[str, Meta(pattern=r"^[0-9a-f]{0,8}\Z")]  # see `machine_name`


class OtherVersionError(LinkError):
    """Message from another version of this package."""


class _Message(msgspec.Struct, tag=True, array_like=True, forbid_unknown_fields=True):
    pass


class Question(_Message):
    """Request from a client, resent with the same number until its reply has a result.

    A client may have died since it sent a request. Therefore an old request energises, releases and runs nothing.
    """

    number: Number
    op: Literal["hello", "start", "stop", "tool", "estop"]
    sent_s: Time = 0.0  # time of sending, host's clock; 0: the client does not know the host's clock yet
    group: str = ""  # start, stop: group of parts
    session: Number = 0  # start, stop: session of the client
    search: bool = True  # start: whether to search for the grippers' stops
    who: str = ""  # start, estop: user, computer and process of the client
    action: Literal["latch", "release", "status"] = "status"  # estop: action
    why: str = ""  # estop: reason of a latch
    sources: list[str] = []  # estop: sources to release; empty: the client's own latch
    tool: Literal["doctor", "identify"] = "doctor"
    channel: str = ""  # tool: channel to identify
    json: bool = False  # tool: whether its output is JSON


class Answer(_Message):
    """Reply to a request."""

    number: Number
    result: dict[str, Any] | None = None  # result; None: not done yet
    error: str = ""  # reason of a refusal
    kind: str = ""  # class name of the error


class Command(_Message):
    """Command record from a client for one part, an arm or a base."""

    session: Number
    number: Number  # grows with each command of the session
    part: Number  # number of the part in the host's reply to hello
    record: Annotated[bytes, Meta(min_length=min(_COMMAND_BYTES), max_length=max(_COMMAND_BYTES))]  # host's clock


class Beat(_Message):
    """Heartbeat of a client, ten times per second; the host replies with an `Echo`."""

    session: Number  # session of the client; 0: the client only watches
    machine: Machine  # computer and user of the client
    sent_s: Time  # time of sending, client's clock
    stopped: bool  # whether the client's own machine has latched the emergency stop


class Echo(_Message):
    """Host's reply to a heartbeat."""

    sent_s: Time  # time at which the heartbeat was sent, client's clock
    received_s: Time  # time of the heartbeat's arrival, host's clock
    answered_s: Time  # time of this reply, host's clock
    held: bool  # whether the heartbeat's session has arms; False after True: the host has released them


class States(_Message):
    """Newest states of all running parts."""

    run: Number  # random id of this run of the host's program
    machine: Machine  # computer and user of the host
    stopped: bool  # whether the host itself has latched the emergency stop
    stopped_by: list[Machine]  # clients whose emergency stops are latched on the host
    parts: list[tuple[Number, Annotated[bytes, Meta(max_length=max(_STATE_BYTES))]]]  # (number, state), host's clock


Message = Question | Answer | Command | Beat | Echo | States
_encoder = msgspec.msgpack.Encoder()
_decoder: msgspec.msgpack.Decoder[Message] = msgspec.msgpack.Decoder(Message)


def encode(message: Message) -> bytes:
    return HEAD + _encoder.encode(message)


def decode(data: bytes) -> Message:
    """Decode a message. Raises LinkError: the message is malformed, or from another version."""
    if not data.startswith(_MAGIC):
        raise LinkError("a message is not of this protocol")
    if not data.startswith(HEAD):
        raise OtherVersionError(
            "the other computer has another version of lerobot_robot_yam (its messages differ); install the same "
            "version on both"
        )
    try:
        return _decoder.decode(memoryview(data)[len(HEAD) :])
    except (ValueError, RecursionError) as error:  # msgspec's own errors are ValueErrors
        raise LinkError(f"a message cannot be read: {error}") from error
