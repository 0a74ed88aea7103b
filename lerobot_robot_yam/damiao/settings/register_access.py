"""Registers of any motor on a bus, whatever its MST_ID. Not for use while another program drives the bus.

Unlike a `MotorChain`, this access needs no profile: a reply is recognised by the motor id, opcode and register in its
data. `RegisterAccess.replies` returns all replies, so two motors with the same id show up as two replies.
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

_ANSWER_S = 0.05  # timeout for a reply, s: the slowest adapters take 16 ms each way
_SECOND_S = 0.02  # timeout for a second motor with the same id, s: it replies right after the first
_ATTEMPTS = 3
_STORE_S = 0.5  # timeout for a motor that writes its flash, s


class Reply(NamedTuple):
    """Value of a register, and the CAN id of the reply."""

    identifier: int
    value: float | int


class RegisterAccess:
    """Access to registers of motors, one motor at a time.

    Raises (every method):
        BusError: the channel is lost or accepts no frames.

    Args:
        bus: open bus that no other program drives.
        channel: the channel's name, for messages.
    """

    def __init__(self, bus: can.BusABC, channel: str):
        self.channel = channel
        self.port = BusPort(bus, channel)

    def replies(self, motor_id: int, register: Register, attempts: int = _ATTEMPTS) -> list[Reply]:
        """Return all replies to one request: several if two motors share this id, none if no motor has it."""
        return self._registers(encode_read(motor_id, register), attempts)

    def find(self, motor_id: int) -> list[Reply]:
        """Return the MST_ID of each motor with this id, and the CAN id of its reply.

        The request is sent three times, since replies of two motors may collide on the wire and be lost.
        """
        return max((self.replies(motor_id, Register.MST_ID, attempts=1) for _ in range(_ATTEMPTS)), key=len)

    def read(self, motor_id: int, register: Register) -> float | int | None:
        """Read a register; None if the motor or its firmware does not report it, or if the value is not finite."""
        for _ in range(_ATTEMPTS):
            reply = next(self._answers(encode_read(motor_id, register), _ANSWER_S), None)
            if reply is not None:
                return reply.value if math.isfinite(reply.value) else None
        return None

    def write(self, motor_id: int, register: Register, value: float) -> None:
        """Set a register in RAM, unverified: a motor whose ids change may reply with the old or new id, or not at all.

        Raises:
            ConfigError: the register is read-only, or cannot represent the value.
        """
        next(self._answers(encode_write(motor_id, register, value), _ANSWER_S), None)

    def write_and_check(self, motor_id: int, register: Register, value: float) -> None:
        """Set a register in RAM and read it back, for registers other than the motor's ids.

        Raises:
            MotorError: the register has another value afterwards, or the motor is silent.
            ConfigError: the register is read-only, or cannot represent the value.
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
        """Make a limp motor store its registers in flash; return whether the motor replied.

        The content of the reply is not documented, so any frame with the motor's id nibble counts.
        """
        self._drain()
        self._send(REGISTER_ID, encode_store(motor_id))
        return any(data[0] & 0xF == motor_id & 0xF for _, data in self._frames(_STORE_S))

    def feedback(self, motor_id: int, master_id: int) -> bytes | None:
        """Request a feedback frame (8 bytes) without commanding motion; None if the motor does not reply."""
        for _ in range(_ATTEMPTS):
            data = self.exchange(motor_id, master_id, REGISTER_ID, encode_refresh(motor_id), _ANSWER_S)
            if data is not None:
                return data
        return None

    def exchange(self, motor_id: int, master_id: int, identifier: int, data: bytes, timeout_s: float) -> bytes | None:
        """Send a frame to which the motor replies with feedback; return the feedback, None on timeout."""
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
        """Return every reply; after the first, wait for a second one."""
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
        """Yield motors' frames for `timeout_s`, skipping those of a handle and register requests of other programs."""
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
