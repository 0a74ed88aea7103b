"""Is a straight move of the joints clear of everything? Finds the pairs of parts that it brings into conflict.

The rule, for every pair on its own: somewhere on the way the pair is nearer than its limit, and nearer than at the
start. So an approach ends at the limit. A pair that is inside it already may stay, go along and get out, but not go
further in.

The whole way is judged, not its end only, by what a move can do at most: with lever arms r_j, the distance of a pair
changes by no more than

    travel = Σ r_j |Δq_j|        over the joints that move one of its parts but not the other

so that a pair that is farther from its limit than travel / 2 at mid-way is clear. A few vector operations on bounding
spheres settle almost all pairs like this. The rest is measured in steps of `_STEP_M` of travel.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from lerobot_robot_yam.arm.collision.pairs import Pair, choose_pairs
from lerobot_robot_yam.arm.collision.parts import ArmParts, GuardedArm

_NOISE_M = 5e-7  # of a distance, which is the same whichever way the arm faces; axes are 1e-6 rad off the vertical
_DEEP_NOISE_M = 2e-5  # of the depth of two cylinders that are in each other
_PASSING_M = 0.0002  # what is let pass between station and end, where no set-point comes to stand
_STEP_M = 0.008  # travel between two looks at a pair
_STEPS = 10  # in a tick at most: then 3 cm apart when all joints of two arms race at 1.5 rad/s


class Conflict(NamedTuple):
    """A pair that comes too near, at this share of the way. Distances in m, at the start and there."""

    pair: Pair
    share: float
    before_m: float
    there_m: float

    @property
    def floor_m(self) -> float:
        """The distance that would do: the limit, or that of the start where it is less."""
        return min(self.pair.limit_m, self.before_m)


class Clearance:
    """The distances of all pairs that matter in one control loop.

    Args:
        arms: at least one; names differ.

    Attributes:
        parts: the arms; `place` moves them.

    Raises:
        ConfigError: a workspace that cannot be used, or arms that stand in one another.
    """

    def __init__(self, arms: Sequence[GuardedArm]):
        self.parts = parts = ArmParts(arms)
        pairs = choose_pairs(parts, arms)
        parts.open_grippers([1.0] * len(arms))
        on_floor = [pair for pair in pairs if parts.floor_height(pair.second) is not None]
        self.pairs = [pair for pair in pairs if pair not in set(on_floor)] + on_floor
        first = np.array([pair.first for pair in self.pairs], dtype=int)
        second = np.array([pair.second for pair in self.pairs], dtype=int)
        spheres = len(pairs) - len(on_floor)
        self._first, self._second = first[:spheres], second[:spheres]
        self._radii = parts.radius[self._first] + parts.radius[self._second]
        self._floor_parts = first[spheres:]
        heights = [parts.floor_height(pair.second) or 0.0 for pair in on_floor]
        self._floor_reach = parts.radius[self._floor_parts] + heights
        self._limits = np.array([pair.limit_m for pair in self.pairs])
        moves_one = (parts.levers[first] > 0) != (parts.levers[second] > 0)
        self._levers = np.where(moves_one, parts.levers[first] + parts.levers[second], 0.0)

    def conflicts(
        self, start: np.ndarray, end: np.ndarray, station: float = 1.0, most_steps: int = _STEPS
    ) -> list[Conflict]:
        """The pairs that the straight move from `start` to `end` (N,) rad brings into conflict, worst first.

        At `station`, a share of the way, and at the end the rule holds exactly; in between to within `_PASSING_M` and
        the curvature of the way between two looks, of which there are `most_steps` at most.
        """
        move = end - start
        travel = self._levers.dot(np.abs(move))
        near = self._near(start + 0.5 * move, travel)
        if not near:
            return []
        steps = min(math.ceil(max(travel[i] for i in near) / _STEP_M), most_steps)
        geoms = [self.pairs[i][:2] for i in near]
        looks = []
        for share in sorted({0.0, station, 1.0, *(step / steps for step in range(1, steps))}):
            self.parts.place(start + share * move)
            looks.append((share, self.parts.distances(geoms)))
        found = []
        _, at_start = looks.pop(0)
        for k, (i, before) in enumerate(zip(near, at_start, strict=True)):
            floor = min(self.pairs[i].limit_m, before) - (_NOISE_M if before > 0.0 else _DEEP_NOISE_M)
            lacking, share, there = max(
                (floor - row[k] - (0.0 if share in (station, 1.0) else _PASSING_M), share, row[k])
                for share, row in looks
            )
            if lacking > 0.0:
                found.append(Conflict(self.pairs[i], share, before, there))
        return sorted(found, key=lambda conflict: conflict.there_m - conflict.pair.limit_m)

    def distance(self, pair: Pair) -> float:
        """Distance of the two parts as they are placed, m; negative: how deep they are in each other."""
        return self.parts.distance(pair.first, pair.second)

    def nearest(self) -> tuple[Pair, float] | None:
        """The pair nearest to its limit as the parts are placed, and its distance. Measures every pair."""
        measured = [(pair, self.distance(pair)) for pair in self.pairs]
        return min(measured, key=lambda row: row[1] - row[0].limit_m, default=None)

    def _near(self, q: np.ndarray, travel: np.ndarray) -> list[int]:
        """Indices of the pairs that come nearer than their limit within half of `travel` (pairs,) from q."""
        parts = self.parts
        parts.place(q)
        x = parts.centres
        between = x.take(self._first, axis=0)
        between -= x.take(self._second, axis=0)
        apart = np.sqrt(np.einsum("ij,ij->i", between, between))
        apart -= self._radii
        if len(self._floor_parts):
            apart = np.concatenate([apart, x[self._floor_parts, 2] - self._floor_reach])
        reach = self._limits + 0.5 * travel
        near = []
        for i in np.flatnonzero(apart < reach).tolist():
            pair, enough = self.pairs[i], float(reach[i])
            if parts.distance(pair.first, pair.second, max(enough, 0.0) + 1e-3) < enough:
                near.append(i)
        return near
