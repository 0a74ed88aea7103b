"""A planned motion: what the dry run draws, the simulator plays, and a real arm is sent, all from one value."""

from typing import NamedTuple

import numpy as np


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
