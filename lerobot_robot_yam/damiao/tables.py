"""Constants of Damiao motors: value ranges per type, fault codes, CAN ids, bus timing.

Sources: I2RT driver v1.2.4 for ranges and fault codes; DM_Control_Python and python-damiao-driver for the register
id and the unit of the watchdog register; Damiao's manuals and register values read by I2RT (driver v1.3.6) for the
gear ratios.
"""

import math
from dataclasses import dataclass
from enum import IntEnum, StrEnum

from lerobot_robot_yam.errors import ConfigError

BITRATE = 1_000_000  # bit/s, classic CAN
BITS_PER_FRAME = 130  # an 8-byte frame with an 11-bit identifier and worst-case bit stuffing
FRAME_TIME_S = BITS_PER_FRAME / BITRATE
BANDWIDTH_MARGIN = 1.1  # safety factor: bus load <= bitrate / margin

REGISTER_ID = 0x7FF  # all register requests go to this identifier
TIMEOUT_COUNT_S = 50e-6  # unit of the TIMEOUT register
WATCHDOG_S = 0.4  # time without a command after which a motor goes limp; factory setting (8000 counts)

# Offsets from motor id to CAN id, per command mode; MIT commands use the motor id itself.
POSITION_VELOCITY_OFFSET = 0x100
VELOCITY_OFFSET = 0x200
FORCE_POSITION_OFFSET = 0x300


class Fault(IntEnum):
    """Fault code (high nibble of a feedback frame) with its text. A motor obeys commands only in state NORMAL."""

    text: str

    def __new__(cls, code: int, text: str) -> "Fault":
        member = int.__new__(cls, code)
        member._value_, member.text = code, text
        return member

    DISABLED = 0x0, "disabled"
    NORMAL = 0x1, "enabled, normal"
    OVER_VOLTAGE = 0x8, "over-voltage (check the supply)"
    UNDER_VOLTAGE = 0x9, "under-voltage (check the supply and its cable)"
    OVER_CURRENT = 0xA, "over-current"
    MOS_OVER_TEMPERATURE = 0xB, "power stage too hot (let it cool)"
    ROTOR_OVER_TEMPERATURE = 0xC, "coil too hot (let it cool)"
    COMMUNICATION_LOST = 0xD, "communication lost: no command within the watchdog time (check the cable)"
    OVERLOAD = 0xE, "overload"


_FAULT_TEXT = {fault.value: fault.text for fault in Fault}


def fault_text(code: int) -> str:
    """Format a fault code for messages: `0xD communication lost …`."""
    return f"0x{code:X} {_FAULT_TEXT.get(code, 'unknown code')}"


class ControlMode(IntEnum):
    """Values of the CTRL_MODE register."""

    MIT = 1
    POSITION_VELOCITY = 2
    VELOCITY = 3
    FORCE_POSITION = 4


class ReceiveMode(StrEnum):
    """Rule that gives the CAN id of a motor's replies (its MST_ID register)."""

    P16 = "p16"
    SAME = "same"
    ZERO = "zero"
    PLUS_ONE = "plus_one"

    def feedback_id(self, motor_id: int) -> int:
        """Return the CAN id of the feedback frames from motor `motor_id`."""
        if self is ReceiveMode.ZERO:
            return 0
        return motor_id + {ReceiveMode.P16: 16, ReceiveMode.SAME: 0}.get(self, 1)


@dataclass(frozen=True)
class MotorType:
    """Motor type with the ranges that scale its frames: values are in [-max, max], gains in [0, max].

    The ranges equal the motor's registers PMAX, VMAX and TMAX; with other ranges every decoded value would be scaled
    wrongly. Gains are in Nm/rad and Nm s/rad. The gear ratio (register GR) is read-only and thus identifies the motor
    type; None: not published. The rotor inertia, reflected to the output, is from google-deepmind/mujoco_menagerie
    (i2rt_yam); for the DM3507 and the DM6248 it is estimated from those values by size and gear ratio.
    """

    name: str
    position_max_rad: float
    velocity_max_rad_s: float
    torque_max_nm: float
    gear_ratio: float | None
    rotor_inertia_kg_m2: float = 0.0  # 0: unknown
    kp_max: float = 500.0
    kd_max: float = 5.0

    @property
    def acceleration_max_rad_s2(self) -> float:
        """Acceleration of the rotor without load under maximum torque; infinite if the inertia is unknown."""
        return self.torque_max_nm / self.rotor_inertia_kg_m2 if self.rotor_inertia_kg_m2 else math.inf


MOTOR_TYPES: dict[str, MotorType] = {
    row.name: row
    for row in (
        MotorType("DM3507", 12.5, 50.0, 5.0, 7.0, 0.0009),
        MotorType("DM4310", 12.5, 30.0, 10.0, 10.0, 0.0018),
        MotorType("DM4310V", 3.1415926, 30.0, 10.0, 10.0, 0.0018),
        MotorType("DM4340", 12.5, 10.0, 28.0, 40.0, 0.032),
        MotorType("DM6248", 12.5, 20.0, 120.0, 48.0, 0.1),
        MotorType("DM8009", 12.5, 45.0, 54.0, 9.0),
        MotorType("DMH6215", 3.1415926, 30.0, 10.0, None),
        MotorType("DMH6215MIT", 12.5, 45.0, 10.0, None),
        MotorType("DM_FLOW_WHEEL", 3.1415926, 30.0, 10.0, 10.0),
    )
}


def motor_type(name: str) -> MotorType:
    """Return the motor type called `name`. Raises ConfigError: no such type."""
    try:
        return MOTOR_TYPES[name]
    except KeyError:
        raise ConfigError(f"unknown motor type {name!r}; known: {', '.join(MOTOR_TYPES)}") from None
