"""Time-optimal motion of n coordinates under limits of speed, acceleration and jerk, by ruckig; and braking.

From rest to rest all coordinates keep the same share of their way (phase synchronisation), so that the way is a
straight line in joint space and does not depend on the speed. From a motion they only end at the same time.
"""

import numpy as np
import ruckig

from lerobot_robot_yam.errors import PlanError
from lerobot_robot_yam.waldo.planning.motion_limits import Limits
from lerobot_robot_yam.waldo.planning.motion_plan import Plan, sample_times, standing

_LATE = 1.05  # of the duration asked for: how much longer a motion may take before it is refused
_TINY = 1e-9
_JERK_SHARES = (1.0, 0.999, 0.99, 0.9)


def move(start: np.ndarray, speed: np.ndarray, target: np.ndarray, limits: Limits, duration_s: float = 0.0) -> Plan:
    """From start (n,), moving with speed (n,), to rest at target (n,).

    Args:
        duration_s: how long it takes; 0 as short as the limits allow.

    Raises:
        PlanError: it takes longer than `duration_s`.
    """
    if np.abs(target - start).max() < _TINY and np.abs(speed).max() < _TINY and not duration_s:
        return standing(start)
    given = _input(start, speed, limits)
    given.target_position = target
    if duration_s > 0.0:
        given.minimum_duration = duration_s
    plan = _sampled(given)
    plan.q[-1], plan.dq[-1] = target, 0.0  # to the last bit: a target may be a limit
    if 0.0 < duration_s * _LATE < plan.duration_s:
        raise PlanError(
            f"this takes at least {plan.duration_s:.2f} s within the limits, not {duration_s:.2f} s; "
            "give it a longer duration, or a speed instead"
        )
    return plan


def brake(start: np.ndarray, speed: np.ndarray, deceleration: np.ndarray) -> Plan:
    """To rest from start (n,), moving with speed (n,), each coordinate evenly with its deceleration (n,).

    No ramp of the deceleration: whatever could brake before a limit with less of it still can.
    """
    lasts_s = np.abs(speed) / deceleration
    if lasts_s.max() < _TINY:
        return standing(start)
    times = sample_times(float(lasts_s.max()))
    braked = np.minimum(times[:, None], lasts_s)
    dq = speed - np.sign(speed) * deceleration * braked
    return Plan(times, start + (speed + dq) / 2.0 * braked, dq)


def _input(start: np.ndarray, speed: np.ndarray, limits: Limits) -> ruckig.InputParameter:
    given = ruckig.InputParameter(len(start))
    given.current_position, given.current_velocity = start, speed
    # ruckig refuses a start that is faster than its limit; a set-point may be, by rounding or from a quicker motion.
    given.max_velocity = np.maximum(limits.speed, np.abs(speed))
    given.max_acceleration, given.max_jerk = limits.acceleration, limits.jerk
    given.synchronization = ruckig.Synchronization.Phase
    return given


def _sampled(given: ruckig.InputParameter) -> Plan:
    trajectory = _trajectory(given)
    times = sample_times(trajectory.duration)
    rows = [trajectory.at_time(t) for t in times.tolist()]
    return Plan(times, np.array([row[0] for row in rows]), np.array([row[1] for row in rows]))


def _trajectory(given: ruckig.InputParameter) -> ruckig.Trajectory:
    """By ruckig, which fails where two of its cases meet to the last bit; a little less jerk gets it out of there."""
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
