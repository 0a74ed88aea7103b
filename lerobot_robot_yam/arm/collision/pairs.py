"""Which parts of the arms are compared, and the distance that each pair keeps.

    two parts of one arm, or of two arms    the collision margin
    a part and a box or the floor           0: those are the limits themselves

Links are compared by their hulls. Parts of one arm that cannot keep the margin by construction are dealt with by two
rules:

- Links that a joint connects, and links that are within `_JOINED_M` of each other over most of the joint range (next
  but one in the chain, their motor housings nearly touch), are not compared.
- Links that are nearer than the margin in the arm's rest pose, where the wrist leans on the shoulder motor, are
  compared shape by shape, and no two shapes keep more distance than they have there, less `_REST_SLACK_M`.
"""

import itertools
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from lerobot_robot_yam.arm.collision.parts import ArmParts, GuardedArm
from lerobot_robot_yam.errors import ConfigError

_JOINED_M = 0.025  # the profiles' joined links are 0 … 16 mm apart in the median, all other links 36 mm and more
_JOINED_SAMPLES = 101
_REST_SLACK_M = 0.004  # a folded arm is a few millimetres off its rest pose


class Pair(NamedTuple):
    """Two parts that keep `limit_m` from each other. arms: those that can change the distance."""

    first: int
    second: int
    limit_m: float
    arms: tuple[int, ...]


def choose_pairs(parts: ArmParts, arms: Sequence[GuardedArm]) -> list[Pair]:
    """All pairs to compare; the second part of a pair may be a thing, the first never is.

    Raises:
        ConfigError: arms that stand in one another.
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
    """The hulls of an arm's links, or the shapes that they consist of."""
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
    """The pairs with one part of each list, nearer to the base first, that no joint connects."""
    both = [(a, b) for a in first for b in second if parts.link[b] - parts.link[a] > 1]
    return [Pair(a, b, margin, (arm,)) for a, b in both]


def _links_of(parts: ArmParts, pair: Pair) -> tuple[int, int]:
    return parts.link[pair.first], parts.link[pair.second]


def _joined(parts: ArmParts, index: int, arm: GuardedArm, pairs: Sequence[Pair]) -> set[tuple[int, int]]:
    """The links that are near each other in most poses."""
    low, high = arm.arm.joint_limits_rad.T
    near = dict.fromkeys((_links_of(parts, pair) for pair in pairs), 0)
    for q in np.random.default_rng(0).uniform(low, high, size=(_JOINED_SAMPLES, len(low))):
        _place_one(parts, index, q)
        close = {_links_of(parts, p) for p in pairs if parts.distance(p.first, p.second, _JOINED_M) < _JOINED_M}
        for links in close:
            near[links] += 1
    return {links for links, count in near.items() if count > _JOINED_SAMPLES // 2}


def _distances_at_rest(parts: ArmParts, index: int, arm: GuardedArm, pairs: Sequence[Pair]) -> np.ndarray:
    """(pairs,) with the gripper open or closed, whichever is nearer."""
    rows = []
    for opening in (0.0, 1.0):
        parts.open_grippers([opening] * len(parts.names))
        _place_one(parts, index, arm.arm.rest_q(arm.gripper.name))
        rows.append([parts.distance(pair.first, pair.second) for pair in pairs])
    return np.min(rows, axis=0)


def _place_one(parts: ArmParts, index: int, q: np.ndarray) -> None:
    everywhere = [q if i == index else np.zeros(n) for i, n in enumerate(parts.joints)]
    parts.place(np.concatenate(everywhere))
