"""Monitor that logs once, not at every tick, what keeps an arm from its target: speed limit, workspace or obstacle."""

import logging
import math
from collections.abc import Sequence

import numpy as np

from lerobot_robot_yam.system.few_values import largest

logger = logging.getLogger(__name__)

_FAR_RAD, _NEAR_RAD = 0.3, 0.1  # gap to the target at which the speed limit begins to hold back, and ends
_PRESSES = 0.5  # share of the torque limit with which a joint presses on an obstacle
_BEHIND_RAD = 0.1  # gap of a joint behind an obstacle: far more than any lag, at any speed and load
_PRESSED_S = 1.0


def far_behind(gap_rad: np.ndarray, kp: np.ndarray, limit_nm: np.ndarray) -> np.ndarray:
    """Return (n,) bool: joints that are farther from their set-points than any lag or load explains.

    Args:
        gap_rad: (n,) distance from the set-points.
        kp, limit_nm: (n,) stiffness (Nm/rad) and largest torque (Nm) of the pull to the set-points.
    """
    far: np.ndarray = np.abs(gap_rad) > np.maximum(_BEHIND_RAD, _PRESSES * limit_nm / np.maximum(kp, 1e-9))
    return far


class ProgressMonitor:
    """Monitor of the arm named `arm` with joints of these names."""

    def __init__(self, arm: str, joints: Sequence[str]):
        self._arm, self._joints = arm, joints
        self._since_s: np.ndarray = np.full(len(joints), math.inf)  # since when each presses
        self._told = np.zeros(len(joints), dtype=bool)
        self._pressing = False  # whether any joint presses, as of the last call
        self._by_speed = self._by_workspace = False

    def by_speed(self, gap_rad: float) -> bool:
        """Return whether the speed limit holds the arm back; `gap_rad` is the largest between target and set-point."""
        before, self._by_speed = self._by_speed, gap_rad > (_NEAR_RAD if self._by_speed else _FAR_RAD)
        if self._by_speed and not before:
            logger.info("%s: target is %.2f rad away; it follows at its speed limit", self._arm, gap_rad)
        return self._by_speed

    def by_workspace(self, by: str) -> bool:
        """Return whether the workspace holds the arm back; `by` names the parts, empty when it does not."""
        if by and not self._by_workspace:
            logger.warning("%s: held back: %s", self._arm, by)
        self._by_workspace = bool(by)
        return self._by_workspace

    def by_obstacle(self, now: float, gap_rad: np.ndarray, kp: np.ndarray, limit_nm: np.ndarray) -> None:
        """Log joints (joints,) that have been far behind their set-points for a while: something is in their way."""
        if not self._pressing and largest(gap_rad) <= _BEHIND_RAD:  # nearly always
            return
        presses = far_behind(gap_rad, kp, limit_nm)
        self._since_s = np.where(presses, np.minimum(self._since_s, now), math.inf)
        self._pressing = bool(presses.any())
        self._told &= presses
        for joint in np.flatnonzero(~self._told & (now - self._since_s > _PRESSED_S)):
            self._told[joint] = True
            what = "%s: %s is %.2f rad from where it is told to be and presses on: something is in its way, or it "
            logger.warning(what + "carries more than it can", self._arm, self._joints[joint], abs(gap_rad[joint]))
