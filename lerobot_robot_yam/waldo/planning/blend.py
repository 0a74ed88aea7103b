"""Two motions made one: the second begins before the first has come to rest, and the corner between them is rounded.

    q(t) = first(t) + second(t − t_b) − corner

so it leaves the first motion and enters the second smoothly, and is at both only where the tool is within a radius of
the corner.
"""

import numpy as np

from lerobot_robot_yam.waldo.planning.motion_plan import Plan
from lerobot_robot_yam.waldo.planning.ruckig_motion import sample_times

_LOOKS = 100  # at each motion, for where it is within the radius


def overlap_s(first: Plan, second: Plan, first_m: np.ndarray, second_m: np.ndarray, radius_m: float) -> float:
    """How long the two may run together, s.

    Args:
        first_m, second_m: (k, 3) of the tool at equal times along each motion, see `look_times`.
        radius_m: how far from the corner the tool may leave them. No motion is shortened by more than half of it.
    """
    leaving = np.linalg.norm(first_m - first_m[-1], axis=1)[::-1] > radius_m
    entering = np.linalg.norm(second_m - second_m[0], axis=1) > radius_m
    spans = []
    for plan, outside in ((first, leaving), (second, entering)):
        inside = int(outside.argmax()) - 1 if outside.any() else _LOOKS
        spans.append(min(max(inside, 0) / _LOOKS, 0.5) * plan.duration_s)
    return min(spans)


def look_times(plan: Plan) -> np.ndarray:
    """(k,) s, evenly over a motion."""
    return np.linspace(0.0, plan.duration_s, _LOOKS + 1)


def superposed(first: Plan, second: Plan, overlap: float) -> Plan:
    """Both, the second begun `overlap` s before the first ends."""
    begin = first.duration_s - overlap
    total = begin + second.duration_s
    times = sample_times(total)
    (q, dq), (further, further_dq) = first.at(times), second.at(times - begin)
    return Plan(times, q + further - second.q[0], dq + further_dq)
