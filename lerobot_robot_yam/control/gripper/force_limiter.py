"""How hard a gripper may press: the force limiter, and the allowance that shrinks while it presses or warms up.

The limiter: while the gripper presses on something, it moves the motor's target so that the fingers squeeze with the
wanted force and no more. The equations are those published for the maker's limiter; tests compare this code with golden
traces (`tests/golden/gripper_limiter.json`):
    T          = map(F_max) + 0.3 Nm                               friction allowance
    s          = sign(target − current)
    zero-effort = previous command − s |effort| / kp
    raw        = zero-effort + s |T| / kp
    filtered   = 0.9 filtered + 0.1 raw
The maker's limiter takes 1 rad for the command before its first, wherever the motor is. A gripper that presses when the
limiter begins gets one tick of wrong torque. This limiter takes the command that explains the measured torque.

The allowance: a gripper that keeps squeezing an object turns all its power into heat. The DM3507's rated torque,
0.8 Nm, is below the 1.03 Nm of a 50 N squeeze. Holding an object takes much less than gripping it.
    stalled   pressing one way, standing still, for a second
    share     goes from 1 to HOLD_SHARE within half a second of the stall, back to 1 when the command lets go
    derating  1 at level 0 of `heat`, 0.3 at the trip; the smaller of the two factors counts
"""

import math
from collections import deque

from lerobot_robot_yam.arm.profile import Limiter

_WINDOW_S = 0.1
_FILTER = 0.1
_FRICTION_ALLOWANCE_NM = 0.3
_LEAVE_EFFORT_NM = 0.2
HOLD_SHARE = 0.5
_STALL_S = 1.0
_EASE_S = 0.5
_STILL_PER_S = 0.05  # speed below which the gripper stands still, strokes/s
_PRESSING_NM = 0.5  # torque from which the gripper presses, at which the maker's limiter begins to act
_SMOOTH_S = 0.1  # time constant of the low-pass filter on torque, s: single readings are noisy
_LOST_STROKES = 0.05  # way after which the object is gone: a gripped one gives way by less
_GAP_S = 0.2  # pause between updates after which a grip starts anew
_TRIP_SHARE = 0.3


class GripForce:
    """Force allowance of one gripper. Update once per tick.

    Attributes:
        stalled: whether the gripper presses on something that does not give way.
        opening: whether the gripper presses outwards while it is stalled.
        press_nm: torque with which the gripper pressed when the stall was noticed, Nm.
    """

    def __init__(self) -> None:
        self.stalled = False
        self.opening = False
        self.press_nm = 0.0
        self._share = 1.0
        self._derating = 1.0
        self._effort = 0.0
        self._place = 0.0
        self._since = math.inf
        self._last = -math.inf

    @property
    def factor(self) -> float:
        """Share of the configured force, 0 … 1."""
        return min(self._share, self._derating)

    def derate(self, level: float) -> None:
        """Take the motor's heat level, 0 … 1, into account."""
        self._derating = 1.0 - (1.0 - _TRIP_SHARE) * min(max(level, 0.0), 1.0)

    def update(self, now: float, u_set: float, u: float, rate: float, tau_nm: float) -> bool:
        """Process one tick.

        Args:
            now: time, s.
            u_set, u: set-point and measured position, 0 closed … 1 open.
            rate: measured speed, strokes/s.
            tau_nm: measured motor torque towards open.

        Returns:
            True on the tick on which a stall is noticed.
        """
        dt = now - self._last
        self._last = now
        opening = u_set > u
        press = tau_nm if opening else -tau_nm
        if dt > _GAP_S or opening is not self.opening:
            self._let_go(opening)
            self._effort = press
            return False
        self._effort += (press - self._effort) * min(dt / _SMOOTH_S, 1.0)
        if self.stalled:
            gone = u - self._place if opening else self._place - u
            if gone > _LOST_STROKES:
                self._let_go(opening)
            else:
                self._share = max(HOLD_SHARE, self._share - (1.0 - HOLD_SHARE) / _EASE_S * dt)
            return False
        if abs(rate) > _STILL_PER_S or self._effort < _PRESSING_NM * self._derating:
            self._since = math.inf
            return False
        self._since = min(self._since, now)
        self.stalled = now - self._since > _STALL_S
        if self.stalled:
            self.press_nm, self._place = self._effort, u
        return self.stalled

    def _let_go(self, opening: bool) -> None:
        self.opening, self.stalled, self._share, self._since = opening, False, 1.0, math.inf


class ForceLimiter:
    """State of one gripper's limiter. Angles are joint-space motor radians, stops [closed, open].

    Args:
        limiter: the profile's parameters of the limiter.
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
        """Return the motor torque, Nm, that squeezes with the wanted force at this angle, with friction allowance."""
        p = self._limiter
        if p.force_map == "linear":
            torque = self.max_force_n * p.gripper_stroke_m / p.motor_stroke_rad
        else:  # crank: F acts on a lever r sin(angle)
            radius = p.gripper_stroke_m / (2.0 * (math.cos(p.close_angle_rad) - math.cos(p.open_angle_rad)))
            torque = self.max_force_n * radius * math.sin(p.motor_reading_offset_rad - motor_rad)
        return torque + _FRICTION_ALLOWANCE_NM

    def limit(self, now: float, target: float, position: float, rate: float, effort: float) -> float:
        """Return the motor angle to command instead of `target`.

        Args:
            now: time, s.
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
        """Note that the gripper opens and squeezes nothing. Call this instead of `limit`, whose rules would clog on an
        obstacle to the opening and unclog again with every tick."""
        self._note(now, effort)  # else the next effort would count as the mean
        self.clogged = False
        self._filtered = None

    def sent(self, command: float) -> None:
        """Note what was really commanded after the final clip."""
        self._previous = command
