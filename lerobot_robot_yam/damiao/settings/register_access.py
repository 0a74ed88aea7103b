"""Registers of any motor on a bus, whatever its answers' identifier. Not for use while somebody drives the bus.

Unlike a `MotorChain`, this access needs no profile: an answer is recognised by the motor id, opcode and register in its
data. `RegisterAccess.replies` returns all answers, so that two motors with the same id show as two answers.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import can

from lerobot_robot_yam.damiao.bus_port import BusPort, data_message, is_classic_data
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.handle_encoder import HANDLE_IDS
from lerobot_robot_yam.damiao.registers import (
    Opcode,
    Register,
    decode_reply,
    encode_read,
    encode_refresh,
    encode_store,
    encode_value,
    encode_write,
)
from lerobot_robot_yam.damiao.tables import REGISTER_ID
from lerobot_robot_yam.errors import MotorError

_ANSWER_S = 0.05  # time to wait for an answer: the slowest adapters take 16 ms each way
_SECOND_S = 0.02  # time to wait for a second motor with the same id, which answers right after the first
_ATTEMPTS = 3
_STORE_S = 0.5  # time to wait for a motor that writes its flash


class Reply(NamedTuple):
    """Value of a register, and the CAN identifier of the answer."""

    identifier: int
    value: float | int


class RegisterAccess:
    """Access to registers of motors, one after the other.

    Raises (every method):
        BusError: the channel is gone or takes no frames.

    Args:
        bus: open bus that nobody else drives.
        channel: the channel's name, for messages.
    """

    def __init__(self, bus: can.BusABC, channel: str):
        self.channel = channel
        self.port = BusPort(bus, channel)

    def replies(self, motor_id: int, register: Register, attempts: int = _ATTEMPTS) -> list[Reply]:
        """Return all answers to one question: several if two motors have this id, none if no motor has."""
        return self._registers(encode_read(motor_id, register), attempts)

    def find(self, motor_id: int) -> list[Reply]:
        """Return the MST_ID of each motor that has this id, and the identifier of its answer.

        The question is sent three times, since answers of two motors may collide on the wire and be lost.
        """
        return max((self.replies(motor_id, Register.MST_ID, attempts=1) for _ in range(_ATTEMPTS)), key=len)

    def read(self, motor_id: int, register: Register) -> float | int | None:
        """Read a register; None when the motor or its firmware reports nothing, or no number."""
        for _ in range(_ATTEMPTS):
            reply = next(self._answers(encode_read(motor_id, register), _ANSWER_S), None)
            if reply is not None:
                return reply.value if math.isfinite(reply.value) else None
        return None

    def write(self, motor_id: int, register: Register, value: float) -> None:
        """Set a register in RAM. Read it back later: a motor whose ids change may answer with either, or not at all.

        Raises:
            ConfigError: the register is read-only, or cannot hold the value.
        """
        next(self._answers(encode_write(motor_id, register, value), _ANSWER_S), None)

    def write_and_check(self, motor_id: int, register: Register, value: float) -> None:
        """Set a register in RAM, at a motor whose id stays.

        Raises:
            MotorError: the register holds another value afterwards, or the motor is silent.
            ConfigError: the register is read-only, or cannot hold the value.
        """
        held = None
        for _ in range(_ATTEMPTS):
            self.write(motor_id, register, value)
            held = self.read(motor_id, register)
            if held is not None and encode_value(register, held) == encode_value(register, value):
                return
        what = "does not answer any more" if held is None else f"still holds {held:g}"
        raise MotorError(f"{self.channel}: motor {motor_id} did not take {register.name} {value:g}: it {what}")

    def store(self, motor_id: int) -> bool:
        """Make a limp motor store its registers to flash; return whether it has answered.

        The content of the answer is not documented, so any frame with the motor's number confirms.
        """
        self._drain()
        self._send(REGISTER_ID, encode_store(motor_id))
        return any(data[0] & 0xF == motor_id & 0xF for _, data in self._frames(_STORE_S))

    def feedback(self, motor_id: int, master_id: int) -> bytes | None:
        """Request a feedback frame (8 bytes), without commanding motion. None when none comes."""
        for _ in range(_ATTEMPTS):
            data = self.exchange(motor_id, master_id, REGISTER_ID, encode_refresh(motor_id), _ANSWER_S)
            if data is not None:
                return data
        return None

    def exchange(self, motor_id: int, master_id: int, identifier: int, data: bytes, timeout_s: float) -> bytes | None:
        """Send a frame that a motor answers with feedback; return the feedback, None when none comes in time."""
        self._drain()
        self._send(identifier, data)
        for found, answer in self._frames(timeout_s):
            if found == master_id and len(answer) == 8 and answer[0] & 0xF == motor_id & 0xF:
                return answer
        return None

    def special(self, motor_id: int, command: SpecialCommand) -> None:
        """Send a special command to a motor."""
        self._send(motor_id, command.value)

    def _registers(self, payload: bytes, attempts: int) -> list[Reply]:
        """Return every answer; wait for a second one after the first."""
        for _ in range(attempts):
            first = next(self._answers(payload, _ANSWER_S), None)
            if first is not None:
                return [first, *self._matching(payload, _SECOND_S)]
        return []

    def _answers(self, payload: bytes, timeout_s: float) -> Iterator[Reply]:
        self._drain()
        self._send(REGISTER_ID, payload)
        yield from self._matching(payload, timeout_s)

    def _matching(self, payload: bytes, timeout_s: float) -> Iterator[Reply]:
        motor_id, opcode, register = int.from_bytes(payload[:2], "little"), Opcode(payload[2]), payload[3]
        for identifier, data in self._frames(timeout_s):
            reply = decode_reply(data)
            if reply is not None and reply[:3] == (motor_id, opcode, register):
                yield Reply(identifier, reply.value)

    def _frames(self, timeout_s: float) -> Iterator[tuple[int, bytes]]:
        """Yield frames of motors for `timeout_s`, without those of a handle and questions of other programs."""
        deadline = self.port.clock.now() + timeout_s
        while (remaining := deadline - self.port.clock.now()) > 0.0:
            message = self.port.recv(remaining)
            if message is None or not is_classic_data(message):
                continue
            if message.arbitration_id != REGISTER_ID and message.arbitration_id not in HANDLE_IDS and message.data:
                yield message.arbitration_id, bytes(message.data)

    def _drain(self) -> None:
        while self.port.recv(0.0) is not None:
            pass

    def _send(self, identifier: int, data: bytes) -> None:
        self.port.send([data_message(identifier, data)])
