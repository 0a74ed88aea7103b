"""Distances between an arm's own links, for inverse kinematics that keeps them."""

import numpy as np

from lerobot_robot_yam.arm.collision.pairs import choose_pairs
from lerobot_robot_yam.arm.collision.parts import ArmParts, GuardedArm
from lerobot_robot_yam.arm.collision.workspace import WorkspaceConfig
from lerobot_robot_yam.arm.profile import ArmProfile, GripperProfile

_NEAR_M = 0.05  # a pair that is farther from its limit than this has no say in the next step
_ENOUGH_M = 5e-4  # of a distance that is called kept: hulls are approximations to millimetres


class SelfClearance:
    """The pairs of links that `part_pairs` compares, gripper open, each with the distance it keeps.

    Args:
        arm, gripper: profiles.
        margin_m: how near links may come to each other; less where they are nearer by construction.

    Raises:
        ConfigError: a margin that cannot be meant.
    """

    def __init__(self, arm: ArmProfile, gripper: GripperProfile, margin_m: float):
        guarded = GuardedArm(arm.name, arm, gripper, WorkspaceConfig(collision_margin_m=margin_m))
        self._parts = ArmParts([guarded])
        self._pairs = choose_pairs(self._parts, [guarded])
        first, second = (np.array([pair[i] for pair in self._pairs], dtype=int) for i in (0, 1))
        self._first, self._second = first, second
        limits = np.array([pair.limit_m for pair in self._pairs])
        self._reach = self._parts.radius[first] + self._parts.radius[second] + limits + _NEAR_M

    def rows(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gradients (k, n), m/rad, and slack (k,), m, of the pairs near their limit at `q` (n,). Below 0: too near."""
        parts = self._parts
        parts.place(q)
        between = parts.centres[self._first] - parts.centres[self._second]
        near = np.flatnonzero(np.einsum("ij,ij->i", between, between) < self._reach**2)
        gradients, slack = [], []
        for pair in (self._pairs[i] for i in near.tolist()):
            distance, gradient = parts.distance_gradient(pair.first, pair.second, pair.limit_m + _NEAR_M)
            if distance < pair.limit_m + _NEAR_M:
                gradients.append(gradient)
                slack.append(distance - pair.limit_m)
        return np.array(gradients).reshape(len(slack), len(q)), np.array(slack)

    def kept(self, q: np.ndarray) -> bool:
        """Whether every pair keeps its distance at `q` (n,)."""
        return bool((self.rows(q)[1] > -_ENOUGH_M).all())
