"""Grip force: the force limiter, and the force allowance, which is reduced during long grips and with motor heat.

The limiter: while the gripper presses on an object, the limiter moves the motor's target so that the fingers squeeze
with the configured force. The equations are published for the manufacturer's limiter; tests compare this code with
golden traces (`tests/golden/gripper_limiter.json`):
    T          = map(F_max) + 0.3 Nm                               friction allowance
    s          = sign(target − current)
    zero-effort = previous command − s |effort| / kp
    raw        = zero-effort + s |T| / kp
    filtered   = 0.9 filtered + 0.1 raw
The manufacturer's limiter starts with a previous command of 1 rad at any motor angle, which causes one tick of wrong
torque if the gripper presses at the start. This limiter starts with the command that explains the measured torque.

The allowance: a gripper that keeps squeezing an object turns all its power into heat. The DM3507's rated torque,
0.8 Nm, is below the 1.03 Nm of a 50 N squeeze. Holding an object takes much less force than gripping it.
    stalled   pressing in one direction without motion for a second
    share     falls from 1 to HOLD_SHARE within half a second after the stall, returns to 1 when the grip ends
    derating  1 at heat level 0, 0.3 at the motor's trip point; the factor in force is the smaller of share and derating
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
_STILL_PER_S = 0.05  # maximum speed of a gripper at rest, strokes/s
_PRESSING_NM = 0.5  # minimum torque of a pressing gripper; the manufacturer's limiter uses the same threshold
_SMOOTH_S = 0.1  # time constant of the torque low-pass filter, s: single readings are noisy
_LOST_STROKES = 0.05  # travel after which an object counts as lost: gripped objects yield less
_GAP_S = 0.2  # pause between updates after which a grip restarts, s
_TRIP_SHARE = 0.3


class GripForce:
    """Force allowance of one gripper. Update once per tick.

    Attributes:
        stalled: whether the gripper presses on an object that does not yield.
        opening: whether the present or last press is outwards.
        press_nm: pressing torque when the stall was detected, Nm.
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
        """Allowed share of the configured force, 0 … 1."""
        return min(self._share, self._derating)

    def derate(self, level: float) -> None:
        """Set the derating from the motor's heat level, 0 … 1."""
        self._derating = 1.0 - (1.0 - _TRIP_SHARE) * min(max(level, 0.0), 1.0)

    def update(self, now: float, u_set: float, u: float, rate: float, tau_nm: float) -> bool:
        """Process one tick.

        Args:
            now: time, s.
            u_set, u: set-point and measured position, 0 closed … 1 open.
            rate: measured speed, strokes/s.
            tau_nm: measured motor torque, positive towards open.

        Returns:
            True at the tick at which a stall is detected.
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
    """Force limiter of one gripper. Angles are joint-space motor angles, rad.

    Args:
        limiter: limiter parameters from the profile.
        kp: the motor's position gain, Nm/rad.
        stops_rad: motor angles [closed, open].
        max_force_n: maximum squeeze force between the fingers; may be changed at any time.
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
        """Return the motor torque, Nm, for a squeeze of `max_force_n` at this angle, including friction allowance."""
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
            target, position: target and measured motor angle, rad.
            rate: normalised gripper velocity, strokes/s, as used by the speed threshold.
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
        """Record that the gripper opens. Call instead of `limit`, which would clog and unclog at every tick if an
        obstacle blocked the opening."""
        self._note(now, effort)  # else the next effort alone would be the mean
        self.clogged = False
        self._filtered = None

    def sent(self, command: float) -> None:
        """Record the motor angle that was commanded after the final clip."""
        self._previous = command
