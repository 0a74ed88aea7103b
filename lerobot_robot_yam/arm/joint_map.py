"""Conversion between motor angles and joint angles: direction, zero offset, and full turns of the encoder.

joint = (motor − offset) · direction; velocity and torque are only multiplied by direction.
"""

import math

import numpy as np

from lerobot_robot_yam.errors import MotorError

TURN = 2.0 * math.pi
RANGE_TOLERANCE_RAD = 0.15  # tolerance of joint ranges for measured angles, rad: at rest, joints 2 and 3 are at a limit
# Minimum difference in fit between the best turn and the next, rad, for a turn to be added: packaged arms have at least
# 0.524. Joint 1 covers almost a full turn: a zero that slipped at one end of its range looks like the other end.
TURN_MARGIN_RAD = 0.5


def resolve_turn(
    arm: str, joint: str, angle_rad: float, lower_rad: float, upper_rad: float, place: str = "--channel CHANNEL"
) -> float:
    """Find the shift (−2π, 0 or 2π, in joint coordinates) that brings a measured angle into the joint's range.

    A Damiao encoder measures its angle within one turn only, so after a power cycle the reading may be off by one turn.
    A reading that is off by more turns is rejected: feedback positions wrap every 25 rad, which is not a whole number
    of turns, so the result would be wrong by 0.13 rad.

    Args:
        arm, joint: names for messages.
        angle_rad: measured joint angle, with the motor direction applied.
        lower_rad, upper_rad: the joint's limits.
        place: options with which `yam-zero` finds the arm, for messages.

    Raises:
        MotorError: no turn fits, or several do; nothing may be energised.
    """
    if not math.isfinite(angle_rad):
        raise MotorError(f"{arm}: {joint} has not been read yet; check the motor's power and cable")
    reads = f"{arm}: {joint} reads {angle_rad:.3f} rad"
    limits = f"its range {lower_rad:.2f} … {upper_rad:.2f}"
    middle = "with the arm limp, move the joint by hand to the middle of its range and start again"
    zero = f"set its zero again (yam-zero {place} --joint {joint})"
    low, high = lower_rad - RANGE_TOLERANCE_RAD, upper_rad + RANGE_TOLERANCE_RAD
    first = math.ceil((low - angle_rad) / TURN)
    last = math.floor((high - angle_rad) / TURN)
    if first > last:
        raise MotorError(f"{reads}, outside {limits} in every turn; {middle}, or {zero}")
    if first < last:
        raise MotorError(f"{reads}, which fits {limits} in {last - first + 1} turns; {middle}")
    if abs(first) > 1:
        raise MotorError(
            f"{reads}, {abs(first)} turns off {limits}, more than a motor can be; switch the arm's power off and on "
            f"again, and if it stays so {zero}"
        )
    if first:
        shifted = angle_rad + first * TURN
        nearest = min(_outside(shifted + turn, lower_rad, upper_rad) for turn in (-TURN, TURN))
        if nearest - _outside(shifted, lower_rad, upper_rad) < TURN_MARGIN_RAD:
            raise MotorError(
                f"{reads}: either just outside {limits}, or one turn off it; {middle}. If it says so again, {zero}"
            )
    return first * TURN


def _outside(angle_rad: float, lower_rad: float, upper_rad: float) -> float:
    """Compute how far an angle is outside a range, rad; 0 inside."""
    return max(lower_rad - angle_rad, angle_rad - upper_rad, 0.0)


class JointMap:
    """Conversion between motor and joint coordinates for n motors.

    Args:
        direction: (n,) +1 or −1.
        offset_rad: (n,) motor angle at joint zero.
    """

    def __init__(self, direction: np.ndarray, offset_rad: np.ndarray):
        self.direction = np.asarray(direction, dtype=float)
        self.offset_rad = np.asarray(offset_rad, dtype=float)
        self._signs = np.ones((len(self.direction), 5))  # signs of q, dq, kp, kd, tau
        self._signs[:, [0, 1, 4]] = self.direction[:, np.newaxis]

    def shift(self, index: int, joint_shift_rad: float) -> None:
        """Shift the zero of one joint so that its joint angle increases by `joint_shift_rad`."""
        self.offset_rad[index] -= joint_shift_rad * self.direction[index]

    def position(self, motor_rad: np.ndarray) -> np.ndarray:
        """Convert (n,) motor angles to joint angles, rad."""
        return (motor_rad - self.offset_rad) * self.direction

    def motor(self, joint_rad: np.ndarray) -> np.ndarray:
        """Convert (n,) joint angles to motor angles, rad."""
        return joint_rad * self.direction + self.offset_rad

    def commands(self, joint_commands: np.ndarray) -> np.ndarray:
        """Convert commands (n, 5) q, dq, kp, kd, tau from joint to motor coordinates; returns a copy."""
        out: np.ndarray = joint_commands * self._signs
        out[:, 0] += self.offset_rad
        return out
