"""A simulated Damiao motor: decodes frames and returns feedback; has registers, states and a watchdog.

No public source documents the following rules; they are our choice:
- ENABLE does not clear a fault; CLEAR does, and leaves the motor disabled.
- Only frames to the motor's own command identifiers reset the watchdog.
- A command of a mode other than CTRL_MODE is answered but not obeyed. Our drivers never leave MIT mode, so this motor
  obeys only MIT commands.
- The reply to STORE is an echo of the request.
"""

import contextlib
import random
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from lerobot_robot_yam.arm.profile import ArmMotor, GripperMotor
from lerobot_robot_yam.damiao import codec, registers
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.registers import Opcode, Register
from lerobot_robot_yam.damiao.tables import (
    REGISTER_ID,
    TIMEOUT_COUNT_S,
    VELOCITY_OFFSET,
    ControlMode,
    Fault,
)
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.devices.flash import Flash, factory_registers
from lerobot_robot_yam.rig.devices.motor_faults import FalseReading, LinkFaults
from lerobot_robot_yam.rig.devices.packets import Frame
from lerobot_robot_yam.rig.devices.thermometer import Thermometer
from lerobot_robot_yam.rig.world.shafts import Drive, LooseShaft
from lerobot_robot_yam.rig.world.world import World

_NORMAL = int(Fault.NORMAL)  # state without a fault, as a plain number because enum look-ups are slow
_RANGES = (Register.PMAX, Register.VMAX, Register.TMAX)
AHEAD_S = 0.003  # maximum time over which a sample is extrapolated, s
_SERVO_KD = 20.0  # gain of the velocity servo, Nm s/rad; our choice: no source documents it
_TWIN_OFFSET_RAD = 0.3  # second motor's angle minus the first motor's at the rig's start; our choice
_TWIN_SERIAL = 100_000  # second motor's serial number minus the first motor's


class SimMotor:
    """One motor on one drive.

    Args:
        row: the motor's row in its profile; replies initially have the row's CAN id + 16.
        zero_rad: motor angle at joint angle 0.
        log: callback that receives the kind and the details of each event.
        serial: content of register SN.
    """

    def __init__(
        self,
        row: ArmMotor | GripperMotor,
        zero_rad: float,
        drive: Drive,
        world: World,
        log: Callable[..., None],
        serial: int,
        mode: ControlMode = ControlMode.MIT,
    ):
        self._row = row
        self.name, self.kind, self.direction, self.zero_rad = row.name, row.type, row.direction, zero_rad
        self.fault: int = Fault.DISABLED
        self.faults = LinkFaults()
        self.sticky_fault = False  # whether the fault survives CLEAR
        self.unpowered = False
        self.bias_nm = 0.0  # see `set_bias`
        self.reading: FalseReading | None = None
        self.twin: SimMotor | None = None  # see `plug_in_twin`
        self.drive, self.world, self._log = drive, world, log
        self._start_rad = drive.angle()
        self.ranges = codec.ranges_of(row.type)
        self.thermometer = Thermometer(random.Random(world.scene.options.seed * 1000 + row.can_id))
        self.last_command_s = 0.0  # simulated time of the last command, s
        self._registers = factory_registers(row, serial, mode)
        self.flash = Flash(self._registers)
        self._written: int | None = None  # register written last
        self._registers_changed()

    @property
    def enabled(self) -> bool:
        return self.fault == _NORMAL

    def plain_settings(self) -> tuple[float, int, int] | None:
        """Return zero angle and both identifiers for `WholeTick` if the motor is plain, else None.

        Plain means enabled in MIT mode, without faults, and with the default settings of the motor's type.
        """
        thermometer = self.thermometer
        if (
            self.fault == _NORMAL
            and self._plainly_set
            and self.reading is self.twin is None
            and not self.faults.set
            and thermometer.held is thermometer.ramp is None
        ):
            return self.zero_rad, self.can_id, self.master_id
        return None

    @property
    def torque_nm(self) -> float:
        """Torque that the motor exerts at the joint, Nm, joint sign."""
        return self.drive.torque()

    @property
    def motor_angle_rad(self) -> float:
        """True multi-turn motor angle, rad."""
        return self.direction * self.drive.angle() + self.zero_rad

    # frames

    def command(self, offset: int, data: bytes, at_s: float) -> Frame | None:
        """Execute a frame to identifier can_id + offset, delivered at `at_s`, and reply. Runs once per frame."""
        if self.faults.silent:
            return None
        special = codec.SPECIAL_OF.get(data)
        self.last_command_s = self.world.sim_s
        if special is not None:
            self._special(special)
        elif offset == 0 and len(data) == 8 and self.fault == Fault.NORMAL and self.mode == ControlMode.MIT:
            self._obey(*codec.unpack_mit(self.ranges, data))
        elif offset == VELOCITY_OFFSET and self.enabled and self.mode == ControlMode.VELOCITY:
            velocity, _ = codec.decode_position_velocity(data)
            self.drive.command(0.0, self.direction * velocity, 0.0, _SERVO_KD, 0.0)
        return self.feedback(at_s)

    def request(self, data: bytes, at_s: float) -> Frame | None:
        """Reply to a register request addressed to this motor, delivered at `at_s`."""
        request = registers.decode_request(data)
        if self.faults.silent or request is None:
            return None
        if request.opcode == Opcode.REFRESH:
            return self.feedback(at_s)
        if request.opcode == Opcode.STORE:
            return self._store(data)
        if request.register not in self._registers:
            return None
        if request.opcode == Opcode.WRITE and registers.REGISTERS[request.register].writable:
            assert request.value is not None
            with contextlib.suppress(ConfigError):  # the reply then contains the old value
                self.set_register(request.register, request.value)
                self._written = request.register
        angle = request.register in (Register.P_M, Register.XOUT)
        value = self.motor_angle_rad if angle else self._registers[request.register]
        # The write may have changed the identifier; the reply has the identifier of the request.
        answer = registers.encode_reply(request.motor_id, request.opcode, request.register, value)
        return Frame(0.0, self.master_id, answer)

    def feedback(self, at_s: float) -> Frame:
        """Encode the state at monotonic time `at_s`; the caller sets the frame's stamp. Runs once per frame.

        The physics may be behind `at_s` by the transmission time of a packet. The position is therefore extrapolated
        with the velocity, which over 3 ms is accurate to less than the frame's last bit.
        """
        direction, drive, world = self.direction, self.drive, self.world
        ahead = at_s - world.stamp_s
        ahead = 0.0 if ahead < 0.0 else AHEAD_S if ahead > AHEAD_S else ahead
        rate = drive.velocity()
        position = direction * (drive.angle() + rate * ahead) + self.zero_rad
        velocity, torque = direction * rate, direction * drive.torque()
        mos, rotor = self.thermometer.read(velocity, torque, world.sim_s, world.stamp_s + ahead)
        if self.reading is not None:
            position, velocity, torque = self.reading.of((position, velocity, torque), direction)
        p_max = self.ranges[0]
        if not -p_max <= position <= p_max:
            position = (position + p_max) % (2 * p_max) - p_max
        if self._scales is not None:
            by = self._scales
            position, velocity, torque = position * by[0], velocity * by[1], torque * by[2]
        status = self.fault << 4 | self.can_id & 0xF
        data = codec.pack_feedback(self.ranges, status, position, velocity, torque, mos, rotor)
        return Frame(0.0, self.master_id, data)

    # state

    def look_after_itself(self) -> None:
        """Enter a fault if too hot, or if commands time out; must be called every few ms of simulated time."""
        sim_s = self.world.sim_s
        if self.thermometer.ramp is not None and self.fault in (Fault.NORMAL, Fault.DISABLED):
            hot = self.thermometer.tripped(self._registers[Register.OT_VALUE], sim_s)
            if hot is not None:
                self.fail(hot)
        if self.fault == _NORMAL and 0.0 < self._timeout_s < sim_s - self.last_command_s:
            self.fail(Fault.COMMUNICATION_LOST)
        if self.bias_nm:
            self.set_bias(self.bias_nm)
        if self.twin is not None:
            self.twin.look_after_itself()

    def set_bias(self, torque_nm: float) -> None:
        """Add a torque (joint sign, Nm) while the motor is enabled; the motor does not report this torque."""
        self.bias_nm = torque_nm
        self.drive.load(torque_nm if self.fault == Fault.NORMAL else 0.0)

    def plug_in_twin(self, angle_rad: float | None = None) -> None:
        """Add a second motor with the same identifiers, which receives each frame and replies after this motor.

        The second motor starts limp, has separate registers and a bare shaft at `angle_rad` (joint sign), and obeys MIT
        commands. Its event kinds have the prefix second_, for example second_motor_enabled.
        """
        angle = self._start_rad + _TWIN_OFFSET_RAD if angle_rad is None else angle_rad
        shaft = LooseShaft(self.world, angle, self.ranges[2])
        serial = int(self._registers[Register.SN]) + _TWIN_SERIAL

        def log(kind: str, **details: Any) -> None:
            self._log(f"second_{kind}", **details)

        row = replace(self._row, can_id=self.can_id)
        self.twin = SimMotor(row, self.zero_rad, shaft, self.world, log, serial)

    def fail(self, fault: int) -> None:
        """Enter a fault and switch the torque off."""
        self._limp()
        self.fault = fault
        self._log("motor_fault", motor=self.name, fault=int(fault))

    def disable(self) -> None:
        if self.fault == Fault.NORMAL:
            self._log("motor_disabled", motor=self.name)
            self.fault = Fault.DISABLED
        self._limp()

    def set_register(self, register: int, value: float) -> None:
        """Overwrite a register, including read-only ones. Raises ConfigError: unknown register or invalid value."""
        registers.encode_value(register, value)  # checks the value
        if register in _RANGES and value <= 0:
            raise ConfigError(f"register {registers.REGISTERS[register].name} must be positive, not {value}")
        if register in (Register.MST_ID, Register.ESC_ID) and value > REGISTER_ID:
            raise ConfigError(f"a CAN identifier is at most {REGISTER_ID:#x}, not {value:#x}")
        self._registers[register] = value
        self._registers_changed()

    def power(self, on: bool) -> None:
        """Switch the power off (the motor is limp and silent), or on again with the registers in flash."""
        if on and self.unpowered:
            self._registers = dict(self.flash.held)
            self._registers_changed()
        self.disable()
        self.fault = Fault.DISABLED
        self.faults.silent = self.unpowered = not on

    def _store(self, data: bytes) -> Frame | None:
        self._registers = self.flash.store(self._registers, self._written)
        self._registers_changed()
        if self.flash.way == "cut":
            self.power(False)
            return None
        return Frame(0.0, self.master_id, bytes(data).ljust(8, b"\x00"))

    def _special(self, special: SpecialCommand) -> None:
        if special is SpecialCommand.ENABLE:
            if self.fault == Fault.DISABLED:
                self._limp()
                self.fault = Fault.NORMAL
                self._log("motor_enabled", motor=self.name)
        elif special is SpecialCommand.DISABLE:
            self.disable()
        elif special is SpecialCommand.ZERO:
            self.zero_rad -= self.motor_angle_rad
        elif self.fault not in (Fault.NORMAL, Fault.DISABLED) and not self.sticky_fault:
            self.fault = Fault.DISABLED
            self._limp()

    def _obey(self, position: float, velocity: float, kp: float, kd: float, torque: float) -> None:
        """Follow a command in motor coordinates, packed in the ranges of the motor's type."""
        if self._scales is not None:
            by = self._scales
            position, velocity, torque = position / by[0], velocity / by[1], torque / by[2]
        direction = self.direction
        true = self.zero_rad + direction * self.drive.angle()
        p_max = self.ranges[0]
        if not -p_max <= true <= p_max:  # commands refer to the turn that feedback reports
            position += true - ((true + p_max) % (2 * p_max) - p_max)
        self.drive.command(direction * (position - self.zero_rad), direction * velocity, kp, kd, direction * torque)

    def _limp(self) -> None:
        self.drive.command(0.0, 0.0, 0.0, 0.0, 0.0)

    def _registers_changed(self) -> None:
        held = self._registers
        self.can_id = int(held[Register.ESC_ID])
        self.mode = int(held[Register.CTRL_MODE])
        self.master_id = int(held[Register.MST_ID])
        self._timeout_s = held[Register.TIMEOUT] * TIMEOUT_COUNT_S
        # The codec packs with the type's ranges; if the registers have other ranges, the values are scaled.
        scales = tuple(mine / held[register] for mine, register in zip(self.ranges, _RANGES, strict=False))
        self._scales: tuple[float, ...] | None = None if all(abs(s - 1) < 1e-6 for s in scales) else scales
        self._plainly_set = self._scales is None and self.mode == ControlMode.MIT
