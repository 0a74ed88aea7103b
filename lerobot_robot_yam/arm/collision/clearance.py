"""Collision check of a straight joint move: finds the pairs of parts that the move brings too near to each other.

A pair is in conflict if, somewhere along the move, it is nearer than its limit and nearer than at the start. So an
approach ends at the limit, and a pair that is already nearer than its limit may stay or separate, but not approach.

For most pairs a bound on the change of their distance is enough. With lever arms r_j, the distance changes by at most

    travel = Σ r_j |Δq_j|        over the joints that move one of the two parts but not the other

so a pair whose distance at the middle of the move exceeds its limit by more than travel / 2 is clear. A few vector
operations on bounding spheres show this for almost all pairs. The others are measured in steps of `_STEP_M` of travel.

These parts are compared, with these limits:

    two parts of one arm, or of two arms    the collision margin
    a part and a box or the floor           0: box and floor have no margin

Links are compared by their hulls. Two rules apply to parts of one arm that cannot keep the margin by construction:

- Links connected by a joint, and links within `_JOINED_M` of each other over most of the joint range (next but one in
  the chain, so that their motor housings nearly touch), are not compared.
- Links that are nearer than the margin in the arm's rest pose, where the wrist leans on the shoulder motor, are
  compared shape by shape. Their limit is the distance at rest minus `_REST_SLACK_M`.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from lerobot_robot_yam.arm.collision.parts import ArmParts, GuardedArm
from lerobot_robot_yam.errors import ConfigError

_NOISE_M = 5e-7  # numerical noise of a distance, m: axes are 1e-6 rad off the vertical
_DEEP_NOISE_M = 2e-5  # numerical noise of the penetration depth of two cylinders, m
_PASSING_M = 0.0002  # tolerance between start and end of a move, m: set-points never stop there
_STEP_M = 0.008  # travel between two measurements of a pair, m
_STEPS = 10  # maximum measurements of a pair per tick: 3 cm apart when all joints of two arms move at 1.5 rad/s
_JOINED_M = 0.025  # median distance below which links count as joined, m: in the profiles 0 … 16 mm, or 36 and more
_JOINED_SAMPLES = 101  # number of random poses for this median
_REST_SLACK_M = 0.004  # tolerance for a folded arm that is not exactly in its rest pose, m


class Pair(NamedTuple):
    """Two parts with the minimum distance `limit_m`. arms: indices of the arms that can change the distance."""

    first: int
    second: int
    limit_m: float
    arms: tuple[int, ...]


class Conflict(NamedTuple):
    """Pair that is too near at the fraction `share` of a move.

    before_m, there_m: distances at the start and at `share`, m.
    """

    pair: Pair
    share: float
    before_m: float
    there_m: float

    @property
    def floor_m(self) -> float:
        """Minimum allowed distance, m: the limit, or the distance at the start if that distance is smaller."""
        return min(self.pair.limit_m, self.before_m)


class Clearance:
    """Distances of all pairs to be checked in one control loop.

    Args:
        arms: one or more arms with different names.

    Attributes:
        parts: parts of the arms; `parts.place` moves the arms.

    Raises:
        ConfigError: a workspace is invalid, or arms overlap.
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
        """Find the pairs that the straight move from `start` to `end` (N,) rad brings into conflict, worst first.

        The check is exact at the fraction `station` (0 … 1) of the move and at its end. Elsewhere, its error is up to
        `_PASSING_M` plus the curvature of the motion between two of at most `most_steps` measurements.
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
        """Measure the current distance between the two parts, m; negative: penetration depth."""
        return self.parts.distance(pair.first, pair.second)

    def _near(self, q: np.ndarray, travel: np.ndarray) -> list[int]:
        """Find indices of the pairs that can come nearer than their limit within half of `travel` (pairs,) from q."""
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


def choose_pairs(parts: ArmParts, arms: Sequence[GuardedArm]) -> list[Pair]:
    """List all pairs to compare. The first part of a pair is a link; the second is a link, a box or a floor.

    Raises:
        ConfigError: two arms overlap.
    """
    pairs: list[Pair] = []
    margins = [arm.workspace.collision_margin_m for arm in arms]
    for i, (arm, margin) in enumerate(zip(arms, margins, strict=True)):
        if margin is not None and arm.arm.joint_count:
            pairs += _own_pairs(parts, i, arm, margin)
        moving = [part for part in _links(parts, i) if parts.link[part]]
        pairs += [Pair(part, thing, 0.0, (i,)) for thing in parts.things_of(i) for part in moving]
    for a, b in itertools.combinations(range(len(arms)), 2):
        asked = [margin for margin in (margins[a], margins[b]) if margin is not None]
        if asked:
            pairs += _pairs_between(parts, a, b, max(asked))
    return pairs


def _links(parts: ArmParts, arm: int, hull: bool = True) -> list[int]:
    """List the hulls of an arm's links or, if `hull` is False, the shapes of these links."""
    return [part for part in range(parts.count) if parts.owner[part] == arm and parts.is_hull[part] == hull]


def _pairs_between(parts: ArmParts, a: int, b: int, margin: float) -> Iterator[Pair]:
    for first, second in itertools.product(_links(parts, a), _links(parts, b)):
        movers = tuple(arm for arm, part in ((a, first), (b, second)) if parts.link[part])
        if movers:
            yield Pair(first, second, margin, movers)
        elif parts.distance(first, second) < 0.0:
            names = f"{parts.part_names[first]} and {parts.part_names[second]}"
            raise ConfigError(
                f"{names} stand in one another: say where each arm's base is in the rig "
                "(workspace.base_position_m, workspace.base_yaw_rad)"
            )


def _own_pairs(parts: ArmParts, index: int, arm: GuardedArm, margin: float) -> Iterator[Pair]:
    hulls, shapes = _links(parts, index), _links(parts, index, hull=False)
    pairs = _apart(parts, index, margin, hulls, hulls)
    joined = _joined(parts, index, arm, pairs)
    pairs = [pair for pair in pairs if _links_of(parts, pair) not in joined]
    in_detail: list[Pair] = []
    for pair, distance in zip(pairs, _distances_at_rest(parts, index, arm, pairs), strict=True):
        if distance - _REST_SLACK_M >= margin:
            yield pair
        else:
            first, second = ([s for s in shapes if parts.body[s] == parts.body[hull]] for hull in pair[:2])
            in_detail += _apart(parts, index, margin, first, second)
    for pair, distance in zip(in_detail, _distances_at_rest(parts, index, arm, in_detail), strict=True):
        yield pair._replace(limit_m=min(margin, float(distance) - _REST_SLACK_M))


def _apart(parts: ArmParts, arm: int, margin: float, first: Sequence[int], second: Sequence[int]) -> list[Pair]:
    """List the pairs of a part from `first` and a later part of the chain from `second` that no joint connects."""
    return [Pair(a, b, margin, (arm,)) for a in first for b in second if parts.link[b] - parts.link[a] > 1]


def _links_of(parts: ArmParts, pair: Pair) -> tuple[int, int]:
    return parts.link[pair.first], parts.link[pair.second]


def _joined(parts: ArmParts, index: int, arm: GuardedArm, pairs: Sequence[Pair]) -> set[tuple[int, int]]:
    """Find the pairs of links that are near each other in most poses."""
    low, high = arm.arm.joint_limits_rad.T
    near = dict.fromkeys((_links_of(parts, pair) for pair in pairs), 0)
    for q in np.random.default_rng(0).uniform(low, high, size=(_JOINED_SAMPLES, len(low))):
        _place_one(parts, index, q)
        close = {_links_of(parts, p) for p in pairs if parts.distance(p.first, p.second, _JOINED_M) < _JOINED_M}
        for links in close:
            near[links] += 1
    return {links for links, count in near.items() if count > _JOINED_SAMPLES // 2}


def _distances_at_rest(parts: ArmParts, index: int, arm: GuardedArm, pairs: Sequence[Pair]) -> np.ndarray:
    """Measure distances (pairs,) in the rest pose, m: the smaller of those with open and with closed gripper."""
    rows = []
    for opening in (0.0, 1.0):
        parts.open_grippers([opening] * len(parts.names))
        _place_one(parts, index, arm.arm.rest_q(arm.gripper))
        rows.append([parts.distance(pair.first, pair.second) for pair in pairs])
    return np.min(rows, axis=0)


def _place_one(parts: ArmParts, index: int, q: np.ndarray) -> None:
    everywhere = [q if i == index else np.zeros(n) for i, n in enumerate(parts.joints)]
    parts.place(np.concatenate(everywhere))
