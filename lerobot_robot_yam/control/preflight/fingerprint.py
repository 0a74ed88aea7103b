"""The fingerprint of an arm: motors and handle that reply on its channel, and the CAN adapter.

Only registers and the handle's version are read; nothing is written, zeroed or energised.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can

from lerobot_robot_yam.arm.config import SOCKETCAN
from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.handle_check import handle_firmware
from lerobot_robot_yam.damiao.motor_spec import MotorSpec
from lerobot_robot_yam.damiao.registers import Register, agrees
from lerobot_robot_yam.damiao.tables import MOTOR_TYPES
from lerobot_robot_yam.errors import MotorError
from lerobot_robot_yam.system.sysfs import SYSFS, read_adapter

_ATTEMPTS = 3
_MOTOR_WAIT_S = 0.02


@dataclass(frozen=True)
class MotorPrint:
    """Identifying register values of one motor; None for values that the motor does not report.

    Attributes:
        gear_ratio: ratio of the built-in gear (register GR), which differs between motor types.
        position_max_rad, velocity_max_rad_s, torque_max_nm: configured ranges of the motor.
        serial: register SN, reserved according to Damiao: the value may be equal on all motors.
        hardware, software, sub: version numbers (registers hw_ver, sw_ver, sub_ver).
    """

    gear_ratio: float | None
    position_max_rad: float | None
    velocity_max_rad_s: float | None
    torque_max_nm: float | None
    serial: int | None
    hardware: int | None
    software: int | None
    sub: int | None

    @property
    def kind(self) -> str:
        """Motor type with this gear ratio and these ranges; if unknown, a text with the values."""
        marks = (self.gear_ratio, self.position_max_rad, self.velocity_max_rad_s, self.torque_max_nm)
        for row in MOTOR_TYPES.values():
            theirs = (row.gear_ratio, row.position_max_rad, row.velocity_max_rad_s, row.torque_max_nm)
            if all(agrees(mine, its) for mine, its in zip(marks, theirs, strict=True)):
                return row.name
        return f"unknown (gear, ranges {' '.join(map(str, marks))})"


@dataclass(frozen=True)
class Adapter:
    """Hardware of a CAN interface as named by the kernel: serial number, and the port used."""

    serial: str | None
    port: str

    def __str__(self) -> str:
        return f"serial {self.serial or 'none'}, port {self.port}"


@dataclass(frozen=True)
class Fingerprint:
    """Fingerprint of the arm on one channel.

    Attributes:
        motors: CAN id -> identifying values of the motor.
        handle_firmware: firmware version of the teaching handle; None: no handle replies.
        adapter: the CAN adapter; None: the interface has no hardware (virtual rig, vcan).
    """

    motors: dict[int, MotorPrint]
    handle_firmware: tuple[int, int, int] | None
    adapter: Adapter | None

    @property
    def serials(self) -> dict[int, int]:
        """CAN id -> serial number, for motors that report one."""
        return {can_id: motor.serial for can_id, motor in self.motors.items() if motor.serial is not None}

    def role(self, gripper_id: int) -> str:
        """Describe the kind of arm. gripper_id: CAN id of a gripper motor."""
        if self.handle_firmware is not None:
            return "leader (a teaching handle answers)"
        if gripper_id in self.motors:
            return "follower (a gripper motor answers)"
        return "arm without handle and gripper motor" if self.motors else "nothing that answers"

    def to_dict(self) -> dict[str, Any]:
        """Convert to JSON-compatible data, see `from_dict`."""
        return {
            "motors": {str(can_id): dict(vars(motor)) for can_id, motor in sorted(self.motors.items())},
            "handle_firmware": None if self.handle_firmware is None else list(self.handle_firmware),
            "adapter": None if self.adapter is None else dict(vars(self.adapter)),
        }

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> "Fingerprint":
        """Create a fingerprint from `to_dict` data. Raises KeyError, TypeError, ValueError: the data are invalid."""
        handle, adapter = data["handle_firmware"], data["adapter"]
        motors = {}
        for can_id, marks in data["motors"].items():
            motor = MotorPrint(**marks)
            if not all(value is None or type(value) in (int, float) for value in vars(motor).values()):
                raise ValueError(f"marks of motor {can_id} are not numbers")
            motors[int(can_id)] = motor
        if adapter is not None:
            adapter = Adapter(**adapter)
            if not isinstance(adapter.port, str) or not isinstance(adapter.serial, str | None):
                raise ValueError("the adapter's marks are not text")
        if handle is not None:
            major, minor, patch = handle
            handle = (int(major), int(minor), int(patch))
        return cls(motors, handle, adapter)


def read_fingerprint(bus: can.BusABC, channel: str, interface: str, ids: Iterable[int]) -> Fingerprint:
    """Read the fingerprint of the arm on a channel. Blocks for up to 0.5 s if many parts are missing.

    Args:
        bus: open bus; no other program may be driving the motors.
        channel, interface: channel and interface names as used by python-can.
        ids: CAN ids of all motors that an arm may have, see `mounting.arm_ids`.

    Raises:
        BusError: the channel is lost.
    """
    chain = MotorChain(bus, [MotorSpec(f"motor {i}", i, "DM4310") for i in ids], channel=channel)
    there = [i for i in range(len(chain)) if _register(chain, i, Register.ESC_ID) is not None]
    motors = {chain.motors[i].can_id: _read_motor(chain, i) for i in there}
    adapter = adapter_of(channel) if interface == SOCKETCAN else None
    return Fingerprint(motors, handle_firmware(bus, channel), adapter)


def gear_ratio(bus: can.BusABC, channel: str, can_id: int) -> float | None:
    """Return the gear ratio of one motor, which depends on the motor type; None if the motor does not reply."""
    chain = MotorChain(bus, [MotorSpec(f"motor {can_id}", can_id, "DM4310")], channel=channel)
    return _register(chain, 0, Register.GR)


def adapter_of(channel: str, sysfs: Path = SYSFS) -> Adapter | None:
    """Return serial number and port of a CAN interface's hardware; None: the interface has no hardware.

    The channels of one adapter differ in `dev_port`, or in `dev_id` with kernel drivers that leave `dev_port` at 0.
    """
    found = read_adapter(sysfs / "class" / "net" / channel)
    if found is None or found.place is None:
        return None
    number = next((n for text in (found.dev_port, found.dev_id) if text and (n := int(text, 0))), 0)
    port = Path(found.place).name
    return Adapter(found.serial, f"{port}/{number}" if number else port)


def _read_motor(chain: MotorChain, index: int) -> MotorPrint:
    def whole(register: Register) -> int | None:
        value = _register(chain, index, register)
        return None if value is None else int(value)

    return MotorPrint(
        gear_ratio=_register(chain, index, Register.GR),
        position_max_rad=_register(chain, index, Register.PMAX),
        velocity_max_rad_s=_register(chain, index, Register.VMAX),
        torque_max_nm=_register(chain, index, Register.TMAX),
        serial=whole(Register.SN),
        hardware=whole(Register.HW_VER),
        software=whole(Register.SW_VER),
        sub=whole(Register.SUB_VER),
    )


def _register(chain: MotorChain, index: int, register: Register) -> float | None:
    """Return a register's value; None: the motor does not reply, or its firmware lacks the register."""
    try:
        return chain.read_register(index, register, timeout_s=_MOTOR_WAIT_S, attempts=_ATTEMPTS)
    except MotorError:
        return None
