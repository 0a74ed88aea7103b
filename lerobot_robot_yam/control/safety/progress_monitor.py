"""Monitor that logs once, not at every tick, why an arm does not reach its target: speed, workspace or obstacle."""

import logging
import math
from collections.abc import Sequence

import numpy as np

from lerobot_robot_yam.system.few_values import largest

logger = logging.getLogger(__name__)

_FAR_RAD, _NEAR_RAD = 0.3, 0.1  # gaps to the target at which the report of the speed limit begins, and ends
_PRESSES = 0.5  # minimum torque of a joint that presses on an obstacle, as a share of the torque limit
_BEHIND_RAD = 0.1  # minimum gap of a joint blocked by an obstacle: far more than any lag, at any speed and load
_PRESSED_S = 1.0


def far_behind(gap_rad: np.ndarray, kp: np.ndarray, limit_nm: np.ndarray) -> np.ndarray:
    """Return (n,) bool: joints farther from their set-points than any lag or load can explain.

    Args:
        gap_rad: (n,) distance from the set-points.
        kp, limit_nm: (n,) stiffness, Nm/rad, and torque limits, Nm.
    """
    far: np.ndarray = np.abs(gap_rad) > np.maximum(_BEHIND_RAD, _PRESSES * limit_nm / np.maximum(kp, 1e-9))
    return far


class ProgressMonitor:
    """Progress monitor for one arm. arm, joints: names of the arm and its joints, for messages."""

    def __init__(self, arm: str, joints: Sequence[str]):
        self._arm, self._joints = arm, joints
        self._since_s: np.ndarray = np.full(len(joints), math.inf)  # start time of each joint's pressing
        self._told = np.zeros(len(joints), dtype=bool)
        self._pressing = False  # whether any joint pressed at the last call
        self._by_speed = self._by_workspace = False

    def by_speed(self, gap_rad: float) -> bool:
        """Return whether the speed limit delays the arm. gap_rad: maximum joint gap between target and set-point."""
        before, self._by_speed = self._by_speed, gap_rad > (_NEAR_RAD if self._by_speed else _FAR_RAD)
        if self._by_speed and not before:
            logger.info("%s: target is %.2f rad away; it follows at its speed limit", self._arm, gap_rad)
        return self._by_speed

    def by_workspace(self, by: str) -> bool:
        """Return whether the workspace guard blocks the arm. by: names of the parts in conflict, or empty."""
        if by and not self._by_workspace:
            logger.warning("%s: held back: %s", self._arm, by)
        self._by_workspace = bool(by)
        return self._by_workspace

    def by_obstacle(self, now: float, gap_rad: np.ndarray, kp: np.ndarray, limit_nm: np.ndarray) -> None:
        """Log joints that have been far behind their set-points for a while, probably blocked. Arrays are (joints,)."""
        if not self._pressing and largest(gap_rad) <= _BEHIND_RAD:  # the usual case
            return
        presses = far_behind(gap_rad, kp, limit_nm)
        self._since_s = np.where(presses, np.minimum(self._since_s, now), math.inf)
        self._pressing = bool(presses.any())
        self._told &= presses
        for joint in np.flatnonzero(~self._told & (now - self._since_s > _PRESSED_S)):
            self._told[joint] = True
            what = "%s: %s is %.2f rad from where it is told to be and presses on: something is in its way, or it "
            logger.warning(what + "carries more than it can", self._arm, self._joints[joint], abs(gap_rad[joint]))
