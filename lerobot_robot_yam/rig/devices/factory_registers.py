"""Register contents of a motor that was set up for an arm."""

import struct

from lerobot_robot_yam.arm.profile import ArmMotor, GripperMotor
from lerobot_robot_yam.damiao import registers
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.damiao.tables import TIMEOUT_COUNT_S, WATCHDOG_S, ControlMode, motor_type


def factory_registers(motor: ArmMotor | GripperMotor, serial: int) -> dict[int, float | int]:
    """Value of every register of a motor of a profile, `serial` in SN; 0 where nothing depends on it."""
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
        Register.CTRL_MODE: ControlMode.MIT,
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
    # A reader gets the float32 that the register holds.
    return {
        key: struct.unpack("<f", struct.pack("<f", value))[0] if registers.REGISTERS[key].kind == "float" else value
        for key, value in held.items()
    }
