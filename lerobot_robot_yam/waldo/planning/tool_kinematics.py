"""Kinematics of the tool's tip: its pose, its motion with the joints, and the joints for a pose."""

import numpy as np

from lerobot_robot_yam.arm.kinematics import IkResult, YamKinematics
from lerobot_robot_yam.arm.profile import ArmProfile, GripperProfile

_REACHED_M, _REACHED_RAD = 2e-5, 2e-5  # largest error of a solution, m and rad: a fifth of the promised error
_ATTEMPTS = 32  # largest number of descents to a distant pose; a pose out of reach takes all, some 40 ms
_FLAT = 1e-6  # share of the largest singular value below which the tip cannot move in a direction


class ToolKinematics:
    """Kinematics of an arm with a tool. Poses (4, 4) are of the tool's tip in the frame of the base, m.

    Not thread-safe. `arm`, `gripper`: resolved profiles.

    Attributes:
        tool: pose (4, 4) of the tip in the flange, the arm's last link; at first the flange itself.
        lower, upper: (n,) limits of the joints, rad.
    """

    def __init__(self, arm: ArmProfile, gripper: GripperProfile):
        self._flange = YamKinematics(arm, gripper, arm.bodies[-1].name)
        self.lower, self.upper = self._flange.lower, self._flange.upper
        self.tool: np.ndarray = np.eye(4)

    def pose(self, q: np.ndarray) -> np.ndarray:
        """Return the poses (…, 4, 4) at joints (…, n) rad, which may lie outside the limits."""
        return self._flange.poses(q) @ self.tool

    def twist(self, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """Return the tip's speed, m/s, and rate of turn, rad/s (6,), at joints (n,) that turn with dq (n,) rad/s."""
        return self._jacobian(q) @ dq

    def rates(self, q: np.ndarray, twist: np.ndarray) -> np.ndarray:
        """Return the joint speeds (n,) that give the tip a twist (6,), rad/s; the least of all solutions."""
        return np.linalg.lstsq(self._jacobian(q), twist, rcond=_FLAT)[0]

    def _jacobian(self, q: np.ndarray) -> np.ndarray:
        """Return the Jacobian (6, n) of the tip, whose speed is the flange's plus ω × lever."""
        jacobian = self._flange.jacobian(q)
        lever = self._flange.poses(q)[:3, :3] @ self.tool[:3, 3]
        jacobian[:3] += np.cross(jacobian[3:], lever, axis=0)
        return jacobian

    def follow(self, pose: np.ndarray, q: np.ndarray, seed: np.ndarray | None = None) -> tuple[np.ndarray, bool]:
        """Return joints near the present ones that bring the tip to a pose, and whether they reach the pose.

        Args:
            q: (n,) present joints; a joint outside its limits may stay there or come back.
            seed: (n,) expected solution; None: q.
        """
        lower, upper = np.minimum(self.lower, q), np.maximum(self.upper, q)
        found = self._flange.descend(self._to_flange(pose), q if seed is None else seed, lower, upper)
        reached = found.position_error_m <= _REACHED_M and found.orientation_error_rad <= _REACHED_RAD
        return found.q, reached

    def solve(self, pose: np.ndarray, near: np.ndarray, turn_over: bool = True) -> IkResult:
        """Return joints for a pose, deterministically; the search starts only at `near` (n,) unless `turn_over`."""
        attempts = _ATTEMPTS if turn_over else 1
        return self._flange.ik(self._to_flange(pose), near, attempts=attempts, budget_s=np.inf)

    def _to_flange(self, pose: np.ndarray) -> np.ndarray:
        return pose @ np.linalg.inv(self.tool)
