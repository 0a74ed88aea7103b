"""Kinematics of the tool's tip: forward kinematics, Jacobian, and inverse kinematics."""

import numpy as np

from lerobot_robot_yam.arm.kinematics import IkResult, YamKinematics
from lerobot_robot_yam.arm.profile import ArmProfile, GripperProfile

_REACHED_M, _REACHED_RAD = 2e-5, 2e-5  # maximum error of a solution, m and rad: a fifth of the promised error
_ATTEMPTS = 32  # maximum number of IK descents for a distant pose; a pose out of reach takes all of them, about 40 ms
_FLAT = 1e-6  # singular values below this fraction of the largest one count as zero: directions the tip cannot move in


class ToolKinematics:
    """Kinematics of an arm with a tool. Poses (4, 4) are those of the tool's tip in the base frame, m.

    Not thread-safe. `arm`, `gripper`: resolved profiles.

    Attributes:
        tool: pose (4, 4) of the tip in the flange frame (the arm's last link). Initially the identity.
        lower, upper: (n,) limits of the joints, rad.
    """

    def __init__(self, arm: ArmProfile, gripper: GripperProfile):
        self._flange = YamKinematics(arm, gripper, arm.bodies[-1].name)
        self.lower, self.upper = self._flange.lower, self._flange.upper
        self.tool: np.ndarray = np.eye(4)

    def pose(self, q: np.ndarray) -> np.ndarray:
        """Return the poses (…, 4, 4) for joints (…, n), rad, which may lie outside the limits."""
        return self._flange.poses(q) @ self.tool

    def twist(self, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """Return the tip's velocity, m/s, and angular velocity, rad/s, as (6,), for q (n,), rad, and dq (n,), rad/s."""
        return self._jacobian(q) @ dq

    def rates(self, q: np.ndarray, twist: np.ndarray) -> np.ndarray:
        """Return joint speeds (n,), rad/s, for a twist (6,) of the tip: the minimum-norm least-squares solution."""
        return np.linalg.lstsq(self._jacobian(q), twist, rcond=_FLAT)[0]

    def _jacobian(self, q: np.ndarray) -> np.ndarray:
        """Return the Jacobian (6, n) of the tip: the tip's velocity is the flange's plus ω × lever."""
        jacobian = self._flange.jacobian(q)
        lever = self._flange.poses(q)[:3, :3] @ self.tool[:3, 3]
        jacobian[:3] += np.cross(jacobian[3:], lever, axis=0)
        return jacobian

    def follow(self, pose: np.ndarray, q: np.ndarray, seed: np.ndarray | None = None) -> tuple[np.ndarray, bool]:
        """Return joints near q that bring the tip to a pose, and whether they reach the pose.

        Args:
            q: (n,) current joints. A joint outside its limits may stay there or come back.
            seed: (n,) expected solution; None: q.
        """
        lower, upper = np.minimum(self.lower, q), np.maximum(self.upper, q)
        found = self._flange.descend(self._to_flange(pose), q if seed is None else seed, lower, upper)
        reached = found.position_error_m <= _REACHED_M and found.orientation_error_rad <= _REACHED_RAD
        return found.q, reached

    def solve(self, pose: np.ndarray, near: np.ndarray, turn_over: bool = True) -> IkResult:
        """Return joints for a pose, deterministically. Without `turn_over`, the search starts at `near` (n,) only."""
        attempts = _ATTEMPTS if turn_over else 1
        return self._flange.ik(self._to_flange(pose), near, attempts=attempts, budget_s=np.inf)

    def _to_flange(self, pose: np.ndarray) -> np.ndarray:
        return pose @ np.linalg.inv(self.tool)
