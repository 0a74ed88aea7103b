"""Inverse kinematics along a path: each solve starts where the two before it lead.

At a singularity, such as the stretched elbow, two branches of solutions meet and a pose alone does not tell which one
to go on with. An arm that moves does: the solution is looked for at q + Δq, with Δq the last step. Without it one
random joint path in ten ends on the wrong branch, half of these at a joint limit.
"""

import math

import numpy as np

from lerobot_robot_yam.arm.kinematics import IkResult, YamKinematics


class PoseTracker:
    """Follows a target pose with the joints of one arm.

    Args:
        kinematics: of the arm; no other thread may use it.
        q: (n,) rad, where the arm is.
    """

    def __init__(self, kinematics: YamKinematics, q: np.ndarray):
        self._kinematics = kinematics
        self.restart(q)

    @property
    def q(self) -> np.ndarray:
        """(n,) rad, the newest solution, or where it was started."""
        return self._q

    def restart(self, q: np.ndarray) -> None:
        """Go on from `q` (n,) rad, standing still."""
        self._q, self._step, self._moving = np.array(q, dtype=float), np.zeros(len(q)), False

    def solve(self, target: np.ndarray, *, attempts: int = 1, within_rad: float | None = None) -> IkResult:
        """Joints for the next pose (4, 4); arguments as for `YamKinematics.ik`. No clock has a say in the result.

        Raises:
            ActionError: no pose; nothing has changed.
        """
        start = self._q + self._step
        result = self._kinematics.ik(target, start, attempts=attempts, budget_s=math.inf, within_rad=within_rad)
        # The way to the first pose, a pose that was not reached or only by another start: no step of the path.
        on_path = result.converged and result.attempts == 1
        self._step = result.q - self._q if self._moving and on_path else np.zeros_like(result.q)
        self._q, self._moving = result.q, on_path
        return result
