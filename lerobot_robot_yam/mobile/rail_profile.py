"""Numbers of the vendor's linear rail; source: I2RT driver v1.2.4, where no other is named."""

from typing import NamedTuple

from lerobot_robot_yam.damiao.motor_spec import MotorSpec
from lerobot_robot_yam.damiao.tables import ControlMode

RAIL_MOTOR = MotorSpec("rail", 9, "DM8009", turns=True, mode=ControlMode.VELOCITY)
STROKE_M = 1.0  # travel between the switches, m
SPEED_RAD_S = 14.0  # maximum speed of the motor, rad/s
HOMING_RAD_S = 7.0  # speed of the motor while it homes, rad/s
HOMING_TIMEOUT_S = 30.0  # maximum time of the way to one switch, s
HARD_CAP_M_S = 1.0  # maximum of the velocity limit, m/s
HARD_CAP_M_S2 = 2.0  # maximum of the acceleration limit, m/s²; our choice: the vendor's driver has none
STOP_RAD_S2 = 100.0  # deceleration in emergencies and while homing, rad/s²; our choice: at rest within 0.14 s
SOFT_END_M = 0.010  # distance from a switch at which the carriage stops by itself, m; our choice
METRES_PER_RAD = (0.002, 0.2)  # range in which a learnt value is believed, m/rad; our choice
GPIO_PINS = (5, 6, 12)  # BCM numbers of upper switch, lower switch and brake
CONVERTER_PINS = (1, 2, 3)  # channels of the USB-GPIO converter, in the same order


class RailScale(NamedTuple):
    """What homing learns: metres per radian, and the motor's angle, rad, at the lower switch, where height is 0."""

    metres_per_rad: float
    zero_rad: float

    def height(self, q: float) -> float:
        """Return the height, m, at a motor angle, rad."""
        return (q - self.zero_rad) * self.metres_per_rad

    def angle(self, height_m: float) -> float:
        """Return the motor angle, rad, at a height, m."""
        return self.zero_rad + height_m / self.metres_per_rad


class RailTarget(NamedTuple):
    """Target of the rail: a velocity, m/s, positive up, or a height, m."""

    value: float
    height: bool = False


class RailState(NamedTuple):
    """State of the rail. Height and velocity are NaN until it is homed."""

    height_m: float  # above the lower switch
    velocity_m_s: float  # positive up
    homed: bool  # whether the height is known
    homing: bool
    upper: bool  # whether each switch is triggered
    lower: bool
    brake_on: bool  # as far as its output tells
    q: float  # angle of the motor, rad
    dq: float  # rad/s
    tau: float  # Nm
