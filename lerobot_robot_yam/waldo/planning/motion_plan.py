"""Planned motions. The dry run draws a plan, the simulator plays it, and a real arm follows it.

ruckig computes time-optimal motions within limits of speed, acceleration and jerk. From rest to rest, all coordinates
are phase-synchronised: at any time, each has covered the same fraction of its distance. So the path is a straight line
in joint space and does not depend on the speed. From a moving start, the coordinates only end at the same time.

Two motions are joined by starting the second one before the first one is at rest. This rounds the corner between them:

    q(t) = first(t) + second(t − t_b) − corner

The joined motion leaves the first motion and enters the second one smoothly. It differs from both only while the tool
is within a radius of the corner.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import ruckig

from lerobot_robot_yam.errors import PlanError
from lerobot_robot_yam.waldo.poses import number

# our choice: 1.5 rad/s after 0.35 s, including the jerk-limited ramps; the control loop's set-point allows 30 rad/s²
JOINT_ACCELERATION_RAD_S2 = 6.0
JOINT_JERK_RAD_S3 = 60.0  # our choice: full acceleration after 0.1 s
STOP_FACTOR = 2.0  # acceleration factor for a stop: from 1.5 rad/s to rest in 0.13 s
LINE_SPEED_M_S, LINE_SPEED_RAD_S = 0.25, 1.2  # our choice: slow enough for a person's hand to follow the arm
LINE_ACCELERATION_M_S2, LINE_ACCELERATION_RAD_S2 = 1.0, 5.0  # our choice: full speed after 0.35 s
LINE_RAMP_S = 0.1  # duration of the ramp to full acceleration, s
JOG_SHARE = 0.5  # fraction of the joint speed limits used for jogging
DEFAULT_SPEED = 0.5  # fraction of the speed limits for commands with speed 0
LEAST_ACCELERATION = 0.05  # minimum fraction of the acceleration limits: Commander's slider goes down to 0
HOME_RAD = np.radians([0.0, 60.0, 60.0, -29.0, 0.0, 0.0])
"""Pose of `home`, away from limits and gimbal lock: the upper arm is raised, the tool points 29° below horizontal."""

_LONGEST_S = 3600.0  # maximum duration of a motion, s
_SAMPLE_S = 0.01  # time between two points of a plan, s: cubics through the points are accurate to 1e-5 rad
_LOOKS = 100  # number of intervals per motion at whose ends the distance to the corner is compared with the radius
_LATE = 1.05  # factor: a motion is refused if it takes longer than this times the required duration
_TINY = 1e-9
_JERK_SHARES = (1.0, 0.999, 0.99, 0.9)


class Limits(NamedTuple):
    """Motion limits of n coordinates: speed (n,) unit/s, acceleration (n,) unit/s², jerk (n,) unit/s³."""

    speed: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray

    def scaled(self, speed: float, acceleration: float) -> "Limits":
        """Return the limits scaled by fractions of speed and acceleration. The jerk is scaled like the acceleration."""
        return Limits(speed * self.speed, acceleration * self.acceleration, acceleration * self.jerk)


def joint_limits(speed_rad_s: np.ndarray) -> Limits:
    """Return the motion limits for joints with speed limits speed_rad_s (n,)."""
    n = len(speed_rad_s)
    return Limits(speed_rad_s.copy(), np.full(n, JOINT_ACCELERATION_RAD_S2), np.full(n, JOINT_JERK_RAD_S3))


def shares(speed: float, accel: float, duration_s: float) -> tuple[float, float]:
    """Return the fractions of the speed and acceleration limits that a command uses.

    Args:
        speed, accel: fractions 0 … 1; speed 0 means `DEFAULT_SPEED`.
        duration_s: required duration, s; if above 0, it replaces the speed.

    Raises:
        PlanError: an argument is not a number, or outside its range.
    """
    fast, quick = number("speed", speed, 0.0, 1.0), number("accel", accel, 0.0, 1.0)
    timed = number("duration", duration_s, 0.0, _LONGEST_S) > 0.0
    return 1.0 if timed else fast or DEFAULT_SPEED, max(quick, LEAST_ACCELERATION)


class Plan(NamedTuple):
    """Motion of n joints through k ≥ 2 points. Between two points, each joint follows a cubic.

    Attributes:
        times_s: (k,) increasing times, s, starting at 0.
        q: (k, n) joint angles, rad.
        dq: (k, n) joint speeds, rad/s.
    """

    times_s: np.ndarray
    q: np.ndarray
    dq: np.ndarray

    @property
    def duration_s(self) -> float:
        """Duration of the motion, s."""
        return float(self.times_s[-1])

    def at(self, t_s: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return q (n,), rad, and dq (n,), rad/s, at a time clamped to the plan; both are (m, n) for times (m,)."""
        t = np.clip(t_s, 0.0, self.times_s[-1])
        i = np.clip(np.searchsorted(self.times_s, t, side="right") - 1, 0, len(self.times_s) - 2)
        h = np.asarray(self.times_s[i + 1] - self.times_s[i])[..., None]
        u = np.asarray(t - self.times_s[i])[..., None] / h
        way, before, after = self.q[i + 1] - self.q[i], h * self.dq[i], h * self.dq[i + 1]
        square, cube = 3.0 * way - 2.0 * before - after, before + after - 2.0 * way  # Hermite's cubic
        q = self.q[i] + u * (before + u * (square + u * cube))
        return q, (before + u * (2.0 * square + 3.0 * u * cube)) / h

    def cut(self, t_s: float) -> "tuple[Plan, Plan]":
        """Split the plan at a time within it; return both parts."""
        i = int(np.searchsorted(self.times_s, t_s))
        q, dq = (value[None] for value in self.at(t_s))
        before = Plan(np.append(self.times_s[:i], t_s), np.append(self.q[:i], q, 0), np.append(self.dq[:i], dq, 0))
        after = Plan(np.append(t_s, self.times_s[i:]) - t_s, np.append(q, self.q[i:], 0), np.append(dq, self.dq[i:], 0))
        return before, after


def standing(q: np.ndarray) -> Plan:
    """Return a plan of 1 ms that stays at q (n,), rad."""
    return Plan(np.array([0.0, 1e-3]), np.array([q, q]), np.zeros((2, len(q))))


def sample_times(duration_s: float) -> np.ndarray:
    """Return evenly spaced times (k,), s, from 0 to duration_s, at most `_SAMPLE_S` apart."""
    return np.linspace(0.0, duration_s, max(math.ceil(duration_s / _SAMPLE_S), 1) + 1)


def overlap_s(first: Plan, second: Plan, pose: Callable[[np.ndarray], np.ndarray], radius_m: float) -> float:
    """Return the maximum time for which two successive motions may overlap, s: at most half of each motion.

    Args:
        pose: function from joints (k, n), rad, to tool poses (k, 4, 4), m.
        radius_m: distance to the corner within which the tool may deviate from the two motions, m.
    """
    looks = [plan.at(np.linspace(0.0, plan.duration_s, _LOOKS + 1))[0] for plan in (first, second)]
    first_m, second_m = (pose(q)[:, :3, 3] for q in looks)
    leaving = np.linalg.norm(first_m - first_m[-1], axis=1)[::-1] > radius_m
    entering = np.linalg.norm(second_m - second_m[0], axis=1) > radius_m
    spans = []
    for plan, outside in ((first, leaving), (second, entering)):
        inside = int(outside.argmax()) - 1 if outside.any() else _LOOKS
        spans.append(min(max(inside, 0) / _LOOKS, 0.5) * plan.duration_s)
    return min(spans)


def superposed(first: Plan, second: Plan, overlap: float) -> Plan:
    """Return both motions as one plan. The second motion starts `overlap` s before the first one ends."""
    begin = first.duration_s - overlap
    times = sample_times(begin + second.duration_s)
    (q, dq), (further, further_dq) = first.at(times), second.at(times - begin)
    return Plan(times, q + further - second.q[0], dq + further_dq)


def move(start: np.ndarray, speed: np.ndarray, target: np.ndarray, limits: Limits, duration_s: float = 0.0) -> Plan:
    """Plan a motion from `start` (n,), moving with `speed` (n,), to rest at `target` (n,).

    `duration_s`: required duration, s; 0: as short as the limits allow.

    Raises:
        PlanError: the motion takes longer than `duration_s`.
    """
    if np.abs(target - start).max() < _TINY and np.abs(speed).max() < _TINY and not duration_s:
        return standing(start)
    given = ruckig.InputParameter(len(start))
    given.current_position, given.current_velocity, given.target_position = start, speed, target
    # ruckig refuses a start above the speed limit, but rounding or a faster previous motion may cause such a start.
    given.max_velocity = np.maximum(limits.speed, np.abs(speed))
    given.max_acceleration, given.max_jerk = limits.acceleration, limits.jerk
    given.synchronization = ruckig.Synchronization.Phase
    if duration_s > 0.0:
        given.minimum_duration = duration_s
    trajectory = _trajectory(given)
    times = sample_times(trajectory.duration)
    rows = [trajectory.at_time(t) for t in times.tolist()]
    plan = Plan(times, np.array([row[0] for row in rows]), np.array([row[1] for row in rows]))
    plan.q[-1], plan.dq[-1] = target, 0.0  # exact, since the target may be a joint limit
    if 0.0 < duration_s * _LATE < plan.duration_s:
        raise PlanError(
            f"this takes at least {plan.duration_s:.2f} s within the limits, not {duration_s:.2f} s; "
            "give it a longer duration, or a speed instead"
        )
    return plan


def brake(start: np.ndarray, speed: np.ndarray, deceleration: np.ndarray) -> Plan:
    """Plan a stop from `start` (n,), moving with `speed` (n,). Each coordinate brakes with its own deceleration (n,).

    The deceleration starts at once, without a ramp, so the stop never takes longer than a motion's own braking.
    """
    lasts_s = np.abs(speed) / deceleration
    if lasts_s.max() < _TINY:
        return standing(start)
    times = sample_times(float(lasts_s.max()))
    braked = np.minimum(times[:, None], lasts_s)
    dq = speed - np.sign(speed) * deceleration * braked
    return Plan(times, start + (speed + dq) / 2.0 * braked, dq)


def _trajectory(given: ruckig.InputParameter) -> ruckig.Trajectory:
    """Compute a trajectory. ruckig can fail at the border between two of its cases; less jerk is then tried."""
    trajectory = ruckig.Trajectory(given.degrees_of_freedom)
    jerk = np.array(given.max_jerk)
    for share in _JERK_SHARES:
        given.max_jerk = share * jerk
        try:
            ruckig.Ruckig(given.degrees_of_freedom).calculate(given, trajectory)
        except ruckig.RuckigError:
            continue
        return trajectory
    raise PlanError(f"no motion was found from {given.current_position} to {given.target_position}; nothing moves")
