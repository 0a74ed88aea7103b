"""The simulated arm: it is where it is asked to be, and its jaws move as fast as the gripper's motor may."""

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.waldo.controller.plant import Reading


class SimulatedArm:
    """A kinematic plant. Nothing that is told it reaches a motor.

    Args:
        hardware: the arm.
        q: (n,) rad, where it is.
    """

    def __init__(self, hardware: ResolvedArm, q: np.ndarray):
        self._q, self._dq = np.array(q), np.zeros(len(q))
        self._jaw_speed = float(hardware.speed_limit[-1]) if hardware.has_gripper else 0.0
        self._opening = self._asked = 1.0 if hardware.has_gripper else None

    def read(self) -> Reading:
        still, zero = self._opening == self._asked, np.zeros(len(self._q))
        return Reading(self._q, self._dq, zero, self._q, self._opening, self._asked, still, 0.0)

    def follow(self, q: np.ndarray, dq: np.ndarray, opening: float | None, dt_s: float) -> None:
        self._q, self._dq = q, dq
        if self._opening is not None and opening is not None:
            most = self._jaw_speed * dt_s
            self._asked = opening
            self._opening += min(max(opening - self._opening, -most), most)

    def rest(self) -> None:
        self._dq = np.zeros(len(self._q))

    def teleport(self, q: np.ndarray, opening: float | None) -> None:
        """Be at q (n,) rad at once, and the jaws at `opening` if that is given."""
        self._q, self._dq = q, np.zeros(len(q))
        if self._opening is not None and opening is not None:
            self._opening = self._asked = opening
