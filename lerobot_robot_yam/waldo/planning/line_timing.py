"""When the tool is where on a line: as fast as the tool, and each joint, may go.

With the share s of the way, joints turn with q' ds/dt and accelerate with q'' (ds/dt)² + q' d²s/dt². One speed holds
for all of a line: the highest that every joint can do everywhere on it.
"""

import numpy as np

from lerobot_robot_yam.errors import PlanError
from lerobot_robot_yam.waldo.planning import ruckig_motion
from lerobot_robot_yam.waldo.planning.motion_limits import (
    LINE_ACCELERATION_M_S2,
    LINE_ACCELERATION_RAD_S2,
    LINE_RAMP_S,
    LINE_SPEED_M_S,
    LINE_SPEED_RAD_S,
    Limits,
)
from lerobot_robot_yam.waldo.planning.motion_plan import Plan

_SLOWEST = 0.1  # of the tool's full speed: where a joint allows no more than this, a singularity is near
_TINY = 1e-9


def timed(
    path: Plan,
    size: tuple[float, float],
    joints: Limits,
    share: tuple[float, float],
    duration_s: float,
    names: list[str],
) -> Plan:
    """A path of the joints over shares of a line as a motion.

    Args:
        path: its times are shares of the way.
        size: of the line, m and rad.
        joints: their limits.
        share: of the limits of speed and of acceleration.
        duration_s: 0 as short as the limits allow.
        names: of the joints.

    Raises:
        PlanError: a joint would have to race, or it takes longer than `duration_s`.
    """
    length, turn = (max(extent, _TINY) for extent in size)
    speed = min(LINE_SPEED_M_S / length, LINE_SPEED_RAD_S / turn)
    acceleration = share[1] * min(LINE_ACCELERATION_M_S2 / length, LINE_ACCELERATION_RAD_S2 / turn)
    rates = np.maximum(np.abs(path.dq).max(axis=0), _TINY)
    bends = np.maximum(np.abs(np.gradient(path.dq, path.times_s, axis=0)).max(axis=0), _TINY)
    allowed = np.minimum(joints.speed / rates, np.sqrt(0.5 * joints.acceleration / bends))
    slowest = int(allowed.argmin())
    if allowed[slowest] < _SLOWEST * speed:
        raise PlanError(
            f"the line passes so near to a singularity that {names[slowest]} would have to turn "
            f"{speed / allowed[slowest]:.0f} times faster than it may; move the joints there instead (move_j)"
        )
    acceleration = min(acceleration, share[1] * float((0.5 * joints.acceleration / rates).min()))
    limits = Limits(
        np.array([min(share[0] * speed, float(allowed.min()))]),
        np.array([acceleration]),
        np.array([acceleration / LINE_RAMP_S]),
    )
    way = ruckig_motion.move(np.zeros(1), np.zeros(1), np.ones(1), limits, duration_s)
    q, rate = path.at(way.q[:, 0])
    return Plan(way.times_s, q, rate * way.dq)
