"""Between motor angles and joint angles: direction, and which turn the joint is on.

joint = (motor − offset) · direction; velocity and torque take the direction only.
"""

import math

import numpy as np

from lerobot_robot_yam.errors import MotorError

TURN = 2.0 * math.pi
RANGE_TOLERANCE_RAD = 0.15  # measured values may lie this far outside: rest lies on the limit of joints 2 and 3


def resolve_turn(arm: str, joint: str, angle_rad: float, lower_rad: float, upper_rad: float) -> float:
    """The shift (a multiple of 2π, in joint coordinates) that brings a measured angle into the joint's range.

    A Damiao encoder knows its angle within one turn only, so after a power cycle the reading may be off by turns.

    Raises:
        MotorError: no turn, or more than one, fits; nothing may be energised.
    """
    low, high = lower_rad - RANGE_TOLERANCE_RAD, upper_rad + RANGE_TOLERANCE_RAD
    first = math.ceil((low - angle_rad) / TURN)
    last = math.floor((high - angle_rad) / TURN)
    if first > last:
        raise MotorError(
            f"{arm}: {joint} reads {angle_rad:.3f} rad, outside its range {lower_rad:.2f} … {upper_rad:.2f} "
            "in every turn; move the joint into its range by hand, or set its zero again"
        )
    if first < last:
        raise MotorError(
            f"{arm}: {joint} reads {angle_rad:.3f} rad, which fits its range {lower_rad:.2f} … {upper_rad:.2f} "
            f"in {last - first + 1} turns; move the joint towards the middle of its range by hand"
        )
    return first * TURN


class JointMap:
    """Motor ↔ joint coordinates of n motors.

    Args:
        direction: (n,) +1 or −1.
        offset_rad: (n,) motor angle at joint zero.
    """

    def __init__(self, direction: np.ndarray, offset_rad: np.ndarray):
        self.direction = np.asarray(direction, dtype=float)
        self.offset_rad = np.asarray(offset_rad, dtype=float)

    def shift(self, index: int, joint_shift_rad: float) -> None:
        """Move the zero of one joint so that its joint angle grows by `joint_shift_rad`."""
        self.offset_rad[index] -= joint_shift_rad * self.direction[index]

    def position(self, motor_rad: np.ndarray) -> np.ndarray:
        """(n,) motor angles to joint angles."""
        return (motor_rad - self.offset_rad) * self.direction

    def commands(self, joint_commands: np.ndarray) -> np.ndarray:
        """(n, 5) q, dq, kp, kd, tau from joint to motor coordinates (a copy)."""
        out = joint_commands.copy()
        out[:, 0] = joint_commands[:, 0] * self.direction + self.offset_rad
        out[:, 1] *= self.direction
        out[:, 4] *= self.direction
        return out
