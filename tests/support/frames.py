"""Random CAN frames, and a bus that delivers them to a client between the answers of its motors."""

import math

import can
from hypothesis import strategies as st

from lerobot_robot_yam.damiao.handle_encoder import HANDLE_IDS
from lerobot_robot_yam.damiao.motor_spec import MotorSpec
from lerobot_robot_yam.damiao.registers import Opcode
from lerobot_robot_yam.damiao.tables import REGISTER_ID, ReceiveMode
from tests.support.desk_bus import DeskBus

SPECS = [
    MotorSpec("a", 1, "DM4340"),
    MotorSpec("b", 2, "DM4310"),
    MotorSpec("c", 7, "DM4310V", ReceiveMode.ZERO),
    MotorSpec("d", 0x17, "DM3507"),  # answers with the nibble of motor 7, on another identifier
]
KNOWN_IDS = sorted({s.can_id for s in SPECS} | {s.feedback_id for s in SPECS} | HANDLE_IDS | {REGISTER_ID, 0x101})


class NoisyBus(DeskBus):
    """A desk on which any message can arrive, whole and unchanged; `noise` does before every answer."""

    def __init__(self, specs: list[MotorSpec], handle: bool = False):
        super().__init__(specs, handle)
        self.noise: list[can.Message] = []

    def deliver(self, message: can.Message) -> None:
        self._queue.append(message)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self._queue.extend(self.noise)
        super().send(msg, timeout)


# How a payload may begin: as feedback of each motor in each state, as a register reply, as anything.
_FEEDBACK = [bytes([fault << 4 | spec.can_id & 0xF]) for spec in SPECS for fault in (0, 1, 0xD)]
_REPLIES = [
    bytes((spec.can_id, 0, opcode, register)) for spec in SPECS for opcode in Opcode for register in (0, 9, 21, 40, 255)
]


def payloads() -> st.SearchStrategy[bytes]:
    """0 … 8 bytes and, rarely, up to the 64 of CAN FD; often all but right for a motor or a register reply."""
    begins = st.sampled_from([b""] * len(_REPLIES) + _FEEDBACK * 3 + _REPLIES)
    lengths = st.sampled_from([8] * 8 + [0, 1, 2, 3, 4, 5, 6, 6, 7, 9, 12, 64])
    return st.builds(
        lambda begin, rest, length: (begin + rest).ljust(length, b"\x5a")[:length],
        begins,
        st.binary(min_size=4, max_size=8),
        lengths,
    )


def messages() -> st.SearchStrategy[can.Message]:
    """Any frame that an adapter can hand over: data, remote, error and extended ones, with or without a stamp."""
    known = [(kind, ident) for kind in ("data", "data", "data", "remote", "error", "extended") for ident in KNOWN_IDS]
    strange = st.tuples(st.just("data"), st.integers(0, 0x7FF)) | st.tuples(
        st.just("extended"), st.integers(0, 0x1FFF_FFFF)
    )
    stamps = st.sampled_from([0.0, 0.0, 1.0, 1e9, 1e10, -1.0, math.inf, math.nan])
    return st.builds(_message, st.sampled_from(known) | strange, payloads(), stamps)


def _message(kind_and_ident: tuple[str, int], data: bytes, stamp: float) -> can.Message:
    kind, ident = kind_and_ident
    return can.Message(
        timestamp=stamp,
        arbitration_id=ident,
        is_extended_id=kind == "extended",
        is_remote_frame=kind == "remote",
        is_error_frame=kind == "error",
        is_fd=len(data) > 8,
        data=data,
        check=False,
    )


@st.composite
def impostors(draw: st.DrawFn, ident: int, data: st.SearchStrategy[bytes]) -> can.Message:
    """A frame with the identifier and contents of an answer that no motor or handle can have sent."""
    extended = draw(st.booleans())
    return can.Message(
        arbitration_id=ident, is_extended_id=extended, is_error_frame=not extended, data=draw(data), check=False
    )


def is_classic_data(message: can.Message) -> bool:
    """Whether a motor or a handle could have sent it at all."""
    return not (message.is_remote_frame or message.is_error_frame or message.is_extended_id)
