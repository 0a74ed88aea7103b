"""A desk whose motors do not play along: registers that stay, stores that change others or are not confirmed."""

import errno
import signal

import can

from lerobot_robot_yam.damiao.registers import Opcode, Register, decode_request
from tests.support.desk_bus import SPECS, DeskBus
from tests.support.waiting import QuickClock


class StubbornDesk(DeskBus):
    """Motors of an arm. Attributes may be changed between frames.

    Attributes:
        stays: registers that keep their value, by motor.
        lost_when_stored: what a store changes, by motor: register and value.
        reverts: the same, once.
        unconfirmed: motors that do not answer a store.
        speechless: motors that answer registers and give no feedback.
        interrupts: the person types Ctrl-C at the next store.
        unplugged_by: the motor after whose next setting the adapter is gone.
    """

    def __init__(self):
        super().__init__(SPECS, handle=True)
        self.clock = QuickClock()
        self.fault = dict.fromkeys(self.specs, 0)
        for registers in self.registers.values():
            registers[Register.OT_VALUE], registers[Register.UV_VALUE] = 100.0, 15.0
        self.stays: dict[int, set[Register]] = {}
        self.lost_when_stored: dict[int, dict[Register, float]] = {}
        self.reverts: dict[int, dict[Register, float]] = {}
        self.unconfirmed: set[int] = set()
        self.speechless: set[int] = set()
        self.stored: list[int] = []
        self.interrupts = False
        self.unplugged_by: int | None = None
        self._unplugged = False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if self._unplugged:
            raise can.CanOperationError("no such device", errno.ENODEV)
        super().send(msg, timeout)
        request = decode_request(bytes(msg.data))
        self._unplugged = (
            request is not None and request.opcode == Opcode.WRITE and request.motor_id == self.unplugged_by
        )

    def recv(self, timeout: float | None = None) -> can.Message | None:
        found = self._recv_internal(0.0)[0]
        if found is None:
            self.clock.sleep(timeout or 0.0)
        return found

    def _answer_register(self, data: bytes) -> None:
        request = decode_request(data)
        can_id, opcode = request.motor_id, request.opcode
        if can_id not in self.specs or (opcode == Opcode.REFRESH and can_id in self.speechless):
            return
        held = self.registers[can_id]
        if opcode == Opcode.STORE:
            self.stored.append(can_id)
            if self.interrupts:
                self.interrupts = False
                signal.raise_signal(signal.SIGINT)
            held |= self.lost_when_stored.get(can_id, {}) | self.reverts.pop(can_id, {})
            if can_id in self.unconfirmed:
                return
        kept = dict(held)
        super()._answer_register(data)
        for register in self.stays.get(can_id, ()):
            held[register] = kept[register]
