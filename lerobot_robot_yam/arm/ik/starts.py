"""Where to start inverse kinematics when there is no pose nearby: at stored poses that resemble the target.

Joint vectors drawn evenly from the joint ranges, with the pose of each. Against starts drawn blindly this halves the
number of descents.
"""

from collections.abc import Callable

import numpy as np

_COUNT = 1000
_SEED = 1
_TURN_M_PER_RAD = 0.3  # of orientation against position, when poses are compared; LEVER_M would find the same places
_TRAVEL_M_PER_RAD = 0.05  # of joint motion from where the arm is: of two that suit, the nearer one first


class Starts:
    """Stored joint vectors and their poses.

    Args:
        fk: (n,) to (4, 4).
        lower, upper: (n,) joint limits, rad.
    """

    def __init__(self, fk: Callable[[np.ndarray], np.ndarray], lower: np.ndarray, upper: np.ndarray):
        self._q = np.random.default_rng(_SEED).uniform(lower, upper, size=(_COUNT, len(lower)))
        self._poses = np.array([fk(q) for q in self._q])

    def nearest(self, pose: np.ndarray, count: int, near: np.ndarray | None = None) -> np.ndarray:
        """(count, n) joint vectors at most, those whose poses resemble `pose` (4, 4) most first.

        Rotations are compared by |R₁ − R₂|² ≈ 2 φ².
        """
        off = self._poses[:, :3] - pose[:3]
        off[:, :, :3] *= _TURN_M_PER_RAD / np.sqrt(2.0)
        distance = np.einsum("kij,kij->k", off, off)
        if near is not None:
            away = np.abs(self._q - near).max(axis=1)
            distance += (_TRAVEL_M_PER_RAD * away) ** 2
        count = min(count, _COUNT)
        best = np.argpartition(distance, count - 1)[:count]
        return self._q[best[np.argsort(distance[best])]]
