"""A planned motion: what the dry run draws, the simulator plays, and a real arm is sent, all from one value.

Two motions become one where the second begins before the first has come to rest. The corner between them is rounded:

    q(t) = first(t) + second(t − t_b) − corner

so it leaves the first motion and enters the second smoothly, and is at both only where the tool is within a radius of
the corner.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

_SAMPLE_S = 0.01  # between two points of a plan; a cubic through them is off by less than 1e-5 rad
_LOOKS = 100  # at each motion, for where it is within the radius


class Plan(NamedTuple):
    """A motion of n joints through k points, k ≥ 2; between two of them each joint moves on a cubic.

    Attributes:
        times_s: (k,) from 0, rising.
        q: (k, n) rad.
        dq: (k, n) rad/s.
    """

    times_s: np.ndarray
    q: np.ndarray
    dq: np.ndarray

    @property
    def duration_s(self) -> float:
        """How long it takes, s."""
        return float(self.times_s[-1])

    def at(self, t_s: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """q (n,) rad and dq (n,) rad/s at a time; at the ends before and after. Of many times (m,): (m, n) each."""
        t = np.clip(t_s, 0.0, self.times_s[-1])
        i = np.clip(np.searchsorted(self.times_s, t, side="right") - 1, 0, len(self.times_s) - 2)
        h = np.asarray(self.times_s[i + 1] - self.times_s[i])[..., None]
        u = np.asarray(t - self.times_s[i])[..., None] / h
        way, before, after = self.q[i + 1] - self.q[i], h * self.dq[i], h * self.dq[i + 1]
        square, cube = 3.0 * way - 2.0 * before - after, before + after - 2.0 * way  # Hermite's cubic
        q = self.q[i] + u * (before + u * (square + u * cube))
        return q, (before + u * (2.0 * square + 3.0 * u * cube)) / h

    def cut(self, t_s: float) -> "tuple[Plan, Plan]":
        """Itself up to a time within it, and from then on."""
        i = int(np.searchsorted(self.times_s, t_s))
        q, dq = (value[None] for value in self.at(t_s))
        before = Plan(np.append(self.times_s[:i], t_s), np.append(self.q[:i], q, 0), np.append(self.dq[:i], dq, 0))
        after = Plan(np.append(t_s, self.times_s[i:]) - t_s, np.append(q, self.q[i:], 0), np.append(dq, self.dq[i:], 0))
        return before, after


def standing(q: np.ndarray) -> Plan:
    """The plan of a move to where the arm is, q (n,) rad: it takes no time that matters."""
    return Plan(np.array([0.0, 1e-3]), np.array([q, q]), np.zeros((2, len(q))))


def sample_times(duration_s: float) -> np.ndarray:
    """(k,) s, evenly from 0 to a duration, at most `_SAMPLE_S` apart."""
    return np.linspace(0.0, duration_s, max(math.ceil(duration_s / _SAMPLE_S), 1) + 1)


def overlap_s(first: Plan, second: Plan, pose: Callable[[np.ndarray], np.ndarray], radius_m: float) -> float:
    """How long the two may run together, s.

    Args:
        pose: of the tool at joints (k, n) rad, (k, 4, 4) m.
        radius_m: how far from the corner the tool may leave them. No motion is shortened by more than half of it.
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
    """Both, the second begun `overlap` s before the first ends."""
    begin = first.duration_s - overlap
    times = sample_times(begin + second.duration_s)
    (q, dq), (further, further_dq) = first.at(times), second.at(times - begin)
    return Plan(times, q + further - second.q[0], dq + further_dq)
