"""Numbers of the vendor's holonomic base ("Flow Base"); each has the vendor's value as its default.

Body frame: +x forward, +y left, rotation counter-clockwise. Casters in the order of the motor ids: rear left, front
left, front right, rear right. Source of every number: I2RT driver v1.2.4.
"""

import math
from dataclasses import dataclass, replace

from lerobot_robot_yam.damiao.motor_spec import MotorSpec
from lerobot_robot_yam.damiao.tables import ControlMode
from lerobot_robot_yam.errors import ConfigError

BASE_MOTORS = 9  # maximum number of motors: eight of the casters, and the rail's
CASTERS = ("rear_left", "front_left", "front_right", "rear_right")
FLIP_RAD_S = 12.56  # steering rate above which a caster counts as flipping, rad/s
COMMAND_TIMEOUT_S = 0.25  # age of the newest command, s, at which the base begins to brake
HARD_CAP = (1.0, 1.0, math.pi)  # maximum of velocity limits: m/s, m/s, rad/s
HARD_CAP_ACCELERATION = (0.8, 0.8, 3.0)  # maximum of acceleration limits: m/s², m/s², rad/s²


@dataclass(frozen=True)
class BaseProfile:
    """Geometry and motors of a base with four powered casters, SI units.

    Attributes:
        h_x_m, h_y_m: (4,) steering axes in the body frame.
        b_x_m, b_y_m: wheel's contact point in the caster's frame; b_x_m is negative, since the wheel trails.
        radius_m: radius of the wheels.
        steer_ids, drive_ids: CAN ids of the motors.
        steer_sign, drive_sign: direction of each motor: 1 or -1.
        steer_type, drive_type: motor types, see `damiao.tables.MOTOR_TYPES`.
    """

    h_x_m: tuple[float, ...] = (-0.2, 0.2, 0.2, -0.2)
    h_y_m: tuple[float, ...] = (0.2, 0.2, -0.2, -0.2)
    b_x_m: float = -0.02
    b_y_m: float = 0.0
    radius_m: float = 0.05
    steer_ids: tuple[int, ...] = (1, 3, 5, 7)
    drive_ids: tuple[int, ...] = (2, 4, 6, 8)
    steer_sign: tuple[int, ...] = (-1, -1, -1, -1)
    drive_sign: tuple[int, ...] = (1, -1, 1, -1)
    steer_type: str = "DM4310V"
    drive_type: str = "DM_FLOW_WHEEL"

    def __post_init__(self) -> None:
        if not (math.isfinite(self.radius_m) and 0.01 <= self.radius_m <= 0.5):
            raise ConfigError(f"base: the wheels' radius is 0.01 to 0.5 m, not {self.radius_m}")
        if not (math.isfinite(self.b_x_m) and -0.5 <= self.b_x_m <= -0.001):
            raise ConfigError(f"base: b_x_m is -0.5 to -0.001 m (the wheel trails), not {self.b_x_m}")

    def resized(self, radius_m: float, track_factor: float) -> "BaseProfile":
        """Return this base with other wheels, and its casters at other distances from the centre."""
        h_x, h_y = (tuple(track_factor * h for h in row) for row in (self.h_x_m, self.h_y_m))
        return replace(self, h_x_m=h_x, h_y_m=h_y, radius_m=radius_m)

    @property
    def signs(self) -> tuple[int, ...]:
        """Directions of the motors, in the order of `motors`."""
        return tuple(sign for pair in zip(self.steer_sign, self.drive_sign, strict=True) for sign in pair)

    def motors(self) -> list[MotorSpec]:
        """Return the motors in the order of the wire: steer and drive motor of each caster."""
        rows = zip(CASTERS, self.steer_ids, self.drive_ids, strict=True)
        return [
            motor
            for name, steer, drive in rows
            for motor in (
                MotorSpec(f"{name}_steer", steer, self.steer_type, turns=True, mode=ControlMode.VELOCITY),
                MotorSpec(f"{name}_drive", drive, self.drive_type, turns=True, mode=ControlMode.VELOCITY),
            )
        ]
