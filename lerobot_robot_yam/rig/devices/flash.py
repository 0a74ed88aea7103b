"""Registers of a simulated motor: initial values, flash contents, and the effect of STORE.

No public source documents a failed STORE, so the two failure modes are our choice:
- "reverts": STORE keeps only the register written last; the others in RAM revert to the flash contents.
- "cut": the power fails during the write. Half of the changed registers are in flash, and the motor is silent.
"""

import struct
from collections.abc import Mapping

from lerobot_robot_yam.arm.profile import ArmMotor, GripperMotor
from lerobot_robot_yam.damiao import registers
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.damiao.tables import TIMEOUT_COUNT_S, WATCHDOG_S, ControlMode, motor_type

WAYS = ("all", "reverts", "cut")


def factory_registers(
    motor: ArmMotor | GripperMotor, serial: int, mode: ControlMode = ControlMode.MIT
) -> dict[int, float | int]:
    """Return the registers of a profile's motor, with `serial` in SN; registers that nothing uses are 0."""
    row = motor_type(motor.type)
    held: dict[int, float | int] = dict.fromkeys(registers.REGISTERS, 0)
    held |= {
        Register.UV_VALUE: 15.0,
        Register.OT_VALUE: 100.0,
        Register.OC_VALUE: 0.98,
        Register.ACC: 10.0,
        Register.DEC: -10.0,
        Register.MAX_SPD: row.velocity_max_rad_s,
        Register.MST_ID: motor.can_id + 16,
        Register.ESC_ID: motor.can_id,
        Register.TIMEOUT: round(WATCHDOG_S / TIMEOUT_COUNT_S),
        Register.CTRL_MODE: mode,
        Register.HW_VER: 10,
        Register.SW_VER: 5013,
        Register.SN: serial,
        Register.NPP: 14,
        Register.GR: row.gear_ratio or 0.0,
        Register.PMAX: row.position_max_rad,
        Register.VMAX: row.velocity_max_rad_s,
        Register.TMAX: row.torque_max_nm,
        Register.GREF: 1.0,
        Register.CAN_BR: 4,
        Register.VBUS: 24.0,
    }
    # Registers hold float32.
    return {
        key: struct.unpack("<f", struct.pack("<f", value))[0] if registers.REGISTERS[key].kind == "float" else value
        for key, value in held.items()
    }


class Flash:
    """Flash of one motor.

    Attributes:
        held: register number → stored value.
        way: effect of STORE, one of `WAYS`.
        writes: number of STORE commands so far.
    """

    def __init__(self, held: Mapping[int, float | int]):
        self.held = dict(held)
        self.way, self.writes = "all", 0

    def store(self, ram: Mapping[int, float | int], last: int | None) -> dict[int, float | int]:
        """Store the registers in `ram`, of which `last` was written last; return the contents of RAM afterwards."""
        self.writes += 1
        changed = [number for number, value in ram.items() if value != self.held[number]]
        if self.way == "cut":
            changed = changed[: (len(changed) + 1) // 2]
        elif self.way == "reverts":
            changed = [number for number in changed if number == last]
        self.held |= {number: ram[number] for number in changed}
        return dict(self.held) if self.way == "reverts" else dict(ram)
