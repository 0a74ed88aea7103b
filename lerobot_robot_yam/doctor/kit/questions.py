"""Read-only requests to motors and handles: the only code through which the doctor sends frames.

Every frame is checked by `harmless` before it is sent, so that no bug elsewhere can enable, move or set anything.
"""

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import NamedTuple

import can

from lerobot_robot_yam.damiao import handle_encoder
from lerobot_robot_yam.damiao.bus_port import BusPort, data_message
from lerobot_robot_yam.damiao.handle_check import ask_handle
from lerobot_robot_yam.damiao.passive_encoders import PassiveEncoders
from lerobot_robot_yam.damiao.registers import Opcode, decode_reply, encode_read, encode_refresh
from lerobot_robot_yam.damiao.tables import REGISTER_ID
from lerobot_robot_yam.errors import LifeCycleError

_BATCH = 4  # requests sent at once: a transmit queue may hold only ten frames
_BATCH_PAUSE_S = 0.002
_REGISTER_TIMEOUT_S, _REGISTER_ATTEMPTS = 0.2, 2
_HANDLE_TIMEOUT_S = 0.1
_TO_MOTORS = frozenset({Opcode.READ, Opcode.REFRESH})
_TO_HANDLE = frozenset({handle_encoder.OP_REPORT, handle_encoder.OP_VERSION, handle_encoder.OP_READ_EEPROM})


class Answer(NamedTuple):
    """Feedback frame: CAN identifier, id nibble and fault nibble of the data, the eight data bytes, arrival time."""

    identifier: int
    nibble: int
    fault: int
    data: bytes
    stamp_s: float


def harmless(identifier: int, data: bytes) -> bool:
    """Return whether a frame changes nothing: a register read, a refresh, or a read request to the teaching handle."""
    if identifier == REGISTER_ID:
        return len(data) == 8 and data[2] in _TO_MOTORS
    return identifier == handle_encoder.REQUEST_ID and len(data) > 1 and data[1] in _TO_HANDLE


class _QuestionPort(BusPort):
    """Port that sends only harmless frames."""

    def send(self, messages: Sequence[can.Message]) -> None:
        for message in messages:
            if not harmless(message.arbitration_id, bytes(message.data)):
                frame = f"0x{message.arbitration_id:X}#{bytes(message.data).hex()}"
                raise LifeCycleError(f"{self.channel}: the doctor does not send {frame}")
        super().send(messages)


class Questions:
    """Requests on one bus. No other program may use the bus meanwhile, since replies do not identify the requester.

    Raises (every method):
        BusError: the channel is disconnected, or accepts no frames.
    """

    def __init__(self, bus: can.BusABC, channel: str):
        self.channel = channel
        self._port = _QuestionPort(bus, channel)
        self.clock = self._port.clock

    def refresh(self, motor_ids: Sequence[int], timeout_s: float, settle_s: float) -> list[Answer]:
        """Request feedback from motors (ids below 16); return the replies until `settle_s` after every motor replied.

        The result includes duplicate replies, and replies with an unexpected identifier.
        """
        self._drain()
        missing = set(motor_ids)
        found: list[Answer] = []
        for start in range(0, len(motor_ids), _BATCH):
            for motor_id in motor_ids[start : start + _BATCH]:
                self._ask(encode_refresh(motor_id))
            self.clock.sleep(_BATCH_PAUSE_S)
        for answer in self._feedback(timeout_s, motor_ids):
            found.append(answer)
            missing.discard(answer.nibble)
            if not missing:
                return [*found, *self._feedback(settle_s, motor_ids)]
        return found

    def round_trip_s(self, motor_id: int, timeout_s: float) -> float | None:
        """Return the time from the request to the arrival of the motor's feedback, s; None without a reply."""
        self._drain()
        self._port.synchronise()
        asked = self.clock.now()
        self._ask(encode_refresh(motor_id))
        return next((max(answer.stamp_s - asked, 0.0) for answer in self._feedback(timeout_s, (motor_id,))), None)

    def register(self, motor_id: int, register: int) -> float | None:
        """Read a register, accepting any identifier of the reply; return None without a reply."""
        for _ in range(_REGISTER_ATTEMPTS):
            self._ask(encode_read(motor_id, register))
            for message in self._frames(_REGISTER_TIMEOUT_S):
                reply = decode_reply(bytes(message.data))
                if reply is not None and reply[:3] == (motor_id, Opcode.READ, register):
                    return reply.value if math.isfinite(reply.value) else None
        return None

    def handle[T](self, request: bytes, identifier: int, decode: Callable[[bytes], T | None]) -> T | None:
        """Send a request to the teaching handle; return the handle's reply, or None without a reply."""
        return ask_handle(self._port, request, decode, _HANDLE_TIMEOUT_S, identifier)

    def encoders(self, joints: int) -> tuple[PassiveEncoders, list[str]]:
        """Read a passive leader's reports; return the reports and the names of devices that report only on request."""
        self._drain()
        found = PassiveEncoders(joints)
        for message in self._frames(_HANDLE_TIMEOUT_S):
            found.accept(message, self._port.arrival_s(message))
        if quiet := found.silent(0.0):
            self._ask(handle_encoder.encode_report_request(), handle_encoder.REQUEST_ID)
            for message in self._frames(_HANDLE_TIMEOUT_S):
                found.accept(message, self._port.arrival_s(message))
        return found, quiet

    def _ask(self, data: bytes, identifier: int = REGISTER_ID) -> None:
        self._port.send([data_message(identifier, data)])

    def _drain(self) -> None:
        while self._port.recv(0.0) is not None:
            pass

    def _frames(self, timeout_s: float) -> Iterator[can.Message]:
        """Yield frames from devices for `timeout_s`, without error frames and other programs' requests."""
        deadline = self.clock.now() + timeout_s
        while (remaining := deadline - self.clock.now()) > 0.0:
            message = self._port.recv(remaining)
            if message is not None and not message.is_error_frame and message.arbitration_id != REGISTER_ID:
                yield message

    def _feedback(self, timeout_s: float, motor_ids: Collection[int]) -> Iterator[Answer]:
        """Yield the feedback from these motors that arrives within `timeout_s`."""
        for message in self._frames(timeout_s):
            data, identifier = bytes(message.data), message.arbitration_id
            if len(data) == 8 and identifier not in handle_encoder.HANDLE_IDS and data[0] & 0xF in motor_ids:
                yield Answer(identifier, data[0] & 0xF, data[0] >> 4, data, self._port.arrival_s(message))
