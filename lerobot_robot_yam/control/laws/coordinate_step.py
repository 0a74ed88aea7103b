"""Laws of one coordinate of a set-point: its speed towards a target, and its step within its limits.

For seven coordinates, numpy would take twice as long.
"""

import math

_LEAST_BRAKING = 0.25  # least share of the acceleration limit that a tracking set-point brakes with


def step_to(
    left: float,
    dt: float,
    gap: float,
    target_velocity: float,
    q: float,
    dq: float,
    speed_limit: float,
    acceleration: float,
    end_deceleration: float,
    lower: float,
    upper: float,
) -> tuple[float, float]:
    """Return position and speed of one coordinate after a tick of `dt` s.

        v = gap / left,  |v − v_target| ≤ sqrt(2 a |gap|),  |v| ≤ speed limit
        |v| ≤ sqrt(2 a_end d), with d the distance to the end of the range,  |v − dq| ≤ a dt

    Args:
        left: time left for closing the gap, s.
        gap: distance to the target's predicted position.
    """
    room = _brakes_within(-gap if gap < 0.0 else gap, acceleration, dt)
    least, most = target_velocity - room, target_velocity + room
    wanted = gap / left
    wanted = least if wanted < least else most if wanted > most else wanted
    return move(dt, q, dq, wanted, speed_limit, acceleration, end_deceleration, lower, upper)


def closing_speed(gap: float, target_ddq: float, acceleration: float, tau: float) -> float:
    """Return the speed relative to a moving target with which its gap is closed without overshoot.

        v = gap / tau near the target, else ±sqrt(2 a |gap| − (a tau)²),  a = acceleration − target's greatest of late

    The two meet with the same value and slope, so that the relative deceleration never exceeds a. The
    target's acceleration is kept free, since a target that brakes takes that much from the set-point's own.
    """
    way = -gap if gap < 0.0 else gap
    a = acceleration - target_ddq
    least = _LEAST_BRAKING * acceleration
    a = least if a < least else a
    speed = way / tau if way <= a * tau * tau else math.sqrt(2.0 * a * way - (a * tau) ** 2)
    return -speed if gap < 0.0 else speed


def move(
    dt: float,
    q: float,
    dq: float,
    wanted: float,
    speed_limit: float,
    acceleration: float,
    end_deceleration: float,
    lower: float,
    upper: float,
) -> tuple[float, float]:
    """Return position and speed of one coordinate after a tick at the speed `wanted`, as far as its limits allow."""
    # Without this bound, a moving target could lead the set-point to the end of the range at full speed.
    most = _brakes_within(q - lower if wanted < 0.0 else upper - q, end_deceleration, dt)
    most = speed_limit if speed_limit < most else most
    wanted = -most if wanted < -most else most if wanted > most else wanted
    change, most = wanted - dq, acceleration * dt
    speed = dq + (-most if change < -most else most if change > most else change)
    q_next = q + speed * dt
    if q_next < lower and q_next < q:
        return (lower if lower < q else q), 0.0
    if q_next > upper and q_next > q:
        return (upper if upper > q else q), 0.0
    return q_next, speed


def _brakes_within(way: float, deceleration: float, dt: float) -> float:
    """Return the maximum speed for braking to rest within `way`, sqrt(2 a way); 0 if `way` is not positive."""
    if way <= 0.0:
        return 0.0
    # The resolution is one tick: without the bound way / dt the last steps would shrink for ever.
    return min(math.sqrt(2.0 * deceleration * way), way / dt)
