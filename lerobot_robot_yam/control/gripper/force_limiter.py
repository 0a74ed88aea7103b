"""Grip-force limiter: while the gripper presses on something, move the motor's target so that it squeezes with the
wanted force and no more.

Equations as published for the maker's limiter (facts: `gripper_force_limiter`), reproduced by golden traces:
    T          = map(F_max) + 0.3 Nm                               friction allowance
    s          = sign(target − current)
    zero-effort = previous command − s |effort| / kp
    raw        = zero-effort + s |T| / kp
    filtered   = 0.9 filtered + 0.1 raw
The maker's takes 1 rad for the command before its first, wherever the motor is: one tick of torque out of nowhere for a
gripper that presses when the limiter begins. Ours takes the command that explains the measured torque.
"""

import math
from collections import deque

from lerobot_robot_yam.arm.profile import Limiter

_WINDOW_S = 0.1
_FILTER = 0.1
_FRICTION_ALLOWANCE_NM = 0.3
_LEAVE_EFFORT_NM = 0.2


class ForceLimiter:
    """State of one gripper's limiter. Angles are joint-space motor radians, stops [closed, open].

    Args:
        limiter: profile parameters.
        kp: gripper gain with which the motor is driven, Nm/rad.
        stops_rad: [closed, open].
        max_force_n: squeeze force between the fingers; may be changed at any time.
    """

    def __init__(self, limiter: Limiter, kp: float, stops_rad: tuple[float, float], max_force_n: float):
        self._limiter = limiter
        self._kp = kp
        self._closed, self._open = stops_rad
        self.max_force_n = max_force_n
        self._efforts: deque[tuple[float, float]] = deque()
        self._effort_sum = 0.0
        self._filtered: float | None = None
        self._previous: float | None = None
        self.clogged = False

    def torque_at(self, motor_rad: float) -> float:
        """Motor torque, Nm, that squeezes with the wanted force at this angle, friction allowance included."""
        p = self._limiter
        if p.force_map == "linear":
            torque = self.max_force_n * p.gripper_stroke_m / p.motor_stroke_rad
        else:  # crank: F acts on a lever r sin(angle)
            radius = p.gripper_stroke_m / (2.0 * (math.cos(p.close_angle_rad) - math.cos(p.open_angle_rad)))
            torque = self.max_force_n * radius * math.sin(p.motor_reading_offset_rad - motor_rad)
        return torque + _FRICTION_ALLOWANCE_NM

    def limit(self, now: float, target: float, position: float, rate: float, effort: float) -> float:
        """The motor angle to command instead of `target`.

        Args:
            now: s.
            target, position: motor rad.
            rate: normalised gripper velocity, strokes/s (the threshold is compared with this).
            effort: measured motor torque, Nm.
        """
        self._note(now, effort)
        mean_effort = abs(self._effort_sum / len(self._efforts))
        span = self._open - self._closed
        opening = (position - self._closed) / span < (target - self._closed) / span
        if self.clogged:
            self.clogged = not (opening or mean_effort < _LEAVE_EFFORT_NM)
        else:
            self.clogged = (
                mean_effort > self._limiter.clog_force_threshold_nm
                and abs(rate) < self._limiter.clog_speed_threshold_per_s
            )
        if self.clogged:
            sign = math.copysign(1.0, target - position) * self._limiter.sign if target != position else 0.0
            previous = position + effort / self._kp if self._previous is None else self._previous
            zero_effort = previous - sign * abs(effort) / self._kp
            raw = zero_effort + sign * abs(self.torque_at(position)) / self._kp
            before = raw if self._filtered is None else self._filtered
            self._filtered = (1.0 - _FILTER) * before + _FILTER * raw
            command = self._filtered
        else:
            self._filtered = position
            command = target
        return command

    def _note(self, now: float, effort: float) -> None:
        self._efforts.append((now, effort))
        self._effort_sum += effort
        while self._efforts[0][0] <= now - _WINDOW_S:
            self._effort_sum -= self._efforts.popleft()[1]

    def release(self, now: float, effort: float) -> None:
        """The gripper opens: nothing is squeezed. Instead of `limit`, whose rules would clog on an obstacle to the
        opening and unclog again with every tick."""
        self._note(now, effort)  # or the first effort after it would count as the mean
        self.clogged = False
        self._filtered = None

    def sent(self, command: float) -> None:
        """Tell what was really commanded after the final clip."""
        self._previous = command
