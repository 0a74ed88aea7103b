"""A CAN bus with motors on a desk: every frame is answered at once, in the caller's thread.

For what no rig can be made to do at an exact moment: a reply that comes one tick late, one answer too many.
"""

import time
from collections import deque

import can

from lerobot_robot_yam.damiao import handle_encoder, registers
from lerobot_robot_yam.damiao.codec import SPECIAL_OF, decode_mit, pack_feedback, ranges_of
from lerobot_robot_yam.damiao.motor_spec import MotorSpec
from lerobot_robot_yam.damiao.registers import Opcode, Register
from lerobot_robot_yam.damiao.tables import REGISTER_ID, motor_type

SPECS = [
    *(MotorSpec(f"joint{i + 1}", i + 1, kind) for i, kind in enumerate(["DM4340"] * 3 + ["DM4310"] * 3)),
    MotorSpec("gripper", 7, "DM4310", turns=True),
]


def encode_feedback(kind, motor_id, fault, position, velocity, torque, temp_mos, temp_rotor) -> bytes:
    """Feedback frame of a motor of this type: rad, rad/s, Nm, °C."""
    status = fault << 4 | motor_id & 0xF
    return pack_feedback(ranges_of(kind), status, position, velocity, torque, int(temp_mos), int(temp_rotor))


class DeskBus(can.BusABC):
    """Motors that go where they are told in no time. Attributes may be changed between frames."""

    def __init__(self, specs: list[MotorSpec], handle: bool = False):
        super().__init__(channel="desk")
        self.specs = {spec.can_id: spec for spec in specs}
        self.handle = handle
        self.handle_data = handle_encoder.encode_report(0.0, 0.0, (False, False))
        self.stubborn = False  # the handle goes on reporting
        self.firmware = (2, 4, 0)
        self.eeprom = bytearray(handle_encoder.EEPROM_BYTES)
        self.position = dict.fromkeys(self.specs, 0.0)  # rad, any number of turns
        self.fault = dict.fromkeys(self.specs, 1)
        self.registers = {spec.can_id: default_registers(spec) for spec in specs}
        self.silent: set[int] = set()
        self.doubled: set[int] = set()
        self.late: set[int] = set()
        self.late_by_a_wait = False  # the late replies arrive all together as somebody's wait for them ends
        self.stall_s = 0.0  # whoever receives the next frame does not run for so long
        self.sent: list[can.Message] = []
        self.chatter: can.Message | None = None  # what somebody says again and again, unasked
        self._held: list[can.Message] = []
        self._queue: deque[can.Message] = deque()

    def put(self, can_id: int, data: bytes, **kwargs: bool) -> None:
        """Put a frame in front of the client that nobody asked for."""
        self._queue.append(can.Message(arbitration_id=can_id, data=data, is_extended_id=False, **kwargs))

    def release(self, count: int | None = None) -> None:
        """Let the late replies arrive now, or the first of them."""
        self._queue.extend(self._held[:count])
        del self._held[:count]

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        data = bytes(msg.data)
        self.sent.append(can.Message(arbitration_id=msg.arbitration_id, data=data, is_extended_id=False))
        if msg.arbitration_id == REGISTER_ID:
            self._answer_register(data)
        elif msg.arbitration_id == handle_encoder.REQUEST_ID and self.handle:
            self._answer_handle(data)
        elif msg.arbitration_id in self.specs:
            spec = self.specs[msg.arbitration_id]
            if data not in SPECIAL_OF:
                self.position[spec.can_id] = decode_mit(spec.type, data).position
            self._answer(spec, self._feedback(spec))

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        stall_s, self.stall_s = self.stall_s, 0.0
        time.sleep(stall_s)
        if not self._queue:
            unasked = self.chatter or self._report_of_its_own()
            if timeout:
                time.sleep(min(timeout, 0.01) if unasked else timeout)
                if self.late_by_a_wait and self._held:
                    self.release()
                    return self._queue.popleft(), False
            return (unasked if timeout else None), False
        return self._queue.popleft(), False

    def _report_of_its_own(self) -> can.Message | None:
        if not self.handle or not self.eeprom[handle_encoder.EEPROM_REPORT_FREQUENCY_LOW]:
            return None
        return can.Message(arbitration_id=handle_encoder.REPORT_ID, data=self.handle_data, is_extended_id=False)

    def _answer(self, spec: MotorSpec, data: bytes) -> None:
        if spec.can_id in self.silent:
            return
        message = can.Message(arbitration_id=spec.feedback_id, data=data, is_extended_id=False)
        queue = self._held if spec.can_id in self.late else self._queue
        queue.append(message)
        if spec.can_id in self.doubled:
            queue.append(message)

    def _feedback(self, spec: MotorSpec) -> bytes:
        half = motor_type(spec.type).position_max_rad
        wrapped = (self.position[spec.can_id] + half) % (2 * half) - half
        return encode_feedback(spec.type, spec.can_id, self.fault[spec.can_id], wrapped, 0.0, 0.0, 30, 31)

    def _answer_register(self, data: bytes) -> None:
        request = registers.decode_request(data)
        assert request is not None
        spec = self.specs[request.motor_id]
        held = self.registers[spec.can_id]
        if request.opcode == Opcode.REFRESH:
            self._answer(spec, self._feedback(spec))
            return
        if request.value is not None:
            held[Register(request.register)] = request.value
        value = held.get(Register(request.register), 0)
        opcode = request.opcode
        self._answer(spec, registers.encode_reply(spec.can_id, opcode, request.register, value))

    def _answer_handle(self, data: bytes) -> None:
        if data[1] == handle_encoder.OP_REPORT:
            self.put(handle_encoder.REPORT_ID, self.handle_data)
        elif data[1] == handle_encoder.OP_VERSION:
            self.put(handle_encoder.REQUEST_ID, handle_encoder.encode_version(self.firmware))
        elif data[1] == handle_encoder.OP_READ_EEPROM:
            self.put(handle_encoder.REQUEST_ID, handle_encoder.encode_eeprom_byte(self.eeprom[data[2]]))
        elif data[1] == handle_encoder.OP_SET_REPORT_FREQUENCY:
            if not self.stubborn:
                self.eeprom[handle_encoder.EEPROM_REPORT_FREQUENCY_LOW] = data[2]
        elif data[1] == handle_encoder.OP_SET_ADC_FREQUENCY:
            self.eeprom[handle_encoder.EEPROM_ADC_FREQUENCY_LOW] = data[2]


def default_registers(spec: MotorSpec) -> dict[Register, float]:
    """Registers of a motor that is set up as the profiles expect."""
    row = motor_type(spec.type)
    return {
        Register.PMAX: row.position_max_rad,
        Register.VMAX: row.velocity_max_rad_s,
        Register.TMAX: row.torque_max_nm,
        Register.TIMEOUT: 8000,
        Register.MST_ID: spec.feedback_id,
        Register.ESC_ID: spec.can_id,
        Register.CTRL_MODE: 1,
        Register.GR: row.gear_ratio or 0.0,
    }
