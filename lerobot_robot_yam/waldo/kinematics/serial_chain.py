"""Forward kinematics of an arm from its profile, with numpy alone: Commander's own process asks for it at 30 Hz.

`arm.kinematics` gives the same poses (a test compares them), but brings MuJoCo, mink and scipy, 0.6 s of import, into
each of the host's processes. Here many joint vectors are one call.

For each joint, with its place A in the link before and K the cross-product matrix of its axis (Rodrigues):

    A R(θ) = A + sin θ · A K + (1 − cos θ) · A K²
"""

from typing import NamedTuple

import numpy as np

from lerobot_robot_yam.arm.profile import ArmProfile, Body, GripperProfile
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.waldo.kinematics.rotation import cross, cross_matrix, of_quaternion


class Place(NamedTuple):
    """Where the flange is, and how it moves with the joints. Of one joint vector or of many, see `SerialChain`.

    Attributes:
        pose: (…, 4, 4) in the frame of the base, m.
        jacobian: (…, 6, n): speed of its origin, m/s, and its rate of turn, rad/s, in the axes of the base, per rad/s.
    """

    pose: np.ndarray
    jacobian: np.ndarray


class SerialChain:
    """The chain of hinges from the base to the arm's last link, the flange.

    Args:
        arm: profile.

    Attributes:
        n: number of joints.
        lower, upper: (n,) rad.

    Raises:
        ConfigError: the arm has no joints.
    """

    def __init__(self, arm: ArmProfile):
        places, turns, self._end = [], [], np.eye(4)
        for body in links(arm):
            self._end = self._end @ frame_of(body)
            if body.joint is not None:
                places.append(self._end)
                turns.append(cross_matrix(body.joint.axis / np.linalg.norm(body.joint.axis)))
                self._end = np.eye(4)
        if not places:
            raise ConfigError(f"arm '{arm.name}' has no joints to plan for")
        self.n = len(places)
        self.lower, self.upper = arm.joint_limits_rad.T.copy()
        k = np.zeros((self.n, 4, 4))
        k[:, :3, :3] = turns
        self._fixed = np.array(places)
        self._sine, self._versine = self._fixed @ k, self._fixed @ k @ k
        self._axes = np.stack([k[:, 2, 1], k[:, 0, 2], k[:, 1, 0]], axis=1)[..., None]

    def pose(self, q: np.ndarray) -> np.ndarray:
        """(…, 4, 4) of the flange at joints q (…, n) rad, which may lie outside the limits."""
        moved = self._moved(q)
        pose = moved[..., 0, :, :]
        for i in range(1, self.n):
            pose = pose @ moved[..., i, :, :]
        return pose @ self._end

    def place(self, q: np.ndarray) -> Place:
        """Pose and Jacobian of the flange at joints q (…, n) rad."""
        moved = self._moved(q)
        for i in range(1, self.n):
            moved[..., i, :, :] = moved[..., i - 1, :, :] @ moved[..., i, :, :]
        pose = moved[..., -1, :, :] @ self._end
        jacobian = np.empty((*np.shape(q)[:-1], 6, self.n))
        turns = (moved[..., :3, :3] @ self._axes)[..., 0]
        jacobian[..., 3:, :] = np.swapaxes(turns, -1, -2)
        jacobian[..., :3, :] = np.swapaxes(cross(turns, pose[..., None, :3, 3] - moved[..., :3, 3]), -1, -2)
        return Place(pose, jacobian)

    def _moved(self, q: np.ndarray) -> np.ndarray:
        angle = np.asarray(q, dtype=float)[..., None, None]
        return self._fixed + np.sin(angle) * self._sine + (1.0 - np.cos(angle)) * self._versine


def links(arm: ArmProfile) -> list[Body]:
    """From the base to the flange."""
    rows = {body.name: body for body in arm.bodies}
    chain = [arm.bodies[-1]]
    while chain[0].parent in rows:
        chain.insert(0, rows[chain[0].parent])
    return chain


def frame_of(body: Body) -> np.ndarray:
    """(4, 4) of a link in its parent, its joint at 0."""
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = of_quaternion(body.quat_wxyz), body.pos_m
    return frame


def tool_centre(gripper: GripperProfile) -> np.ndarray:
    """(4, 4) of the point between the fingers in the flange, m; of an end effector without fingers its tip.

    Args:
        gripper: as mounted, see `mounting.mounted`: its first body is fixed to the flange.
    """
    (root, *_) = gripper.bodies
    sites = {site.name: site for site in root.sites}
    site, frame = sites.get("grasp_site", sites["tcp_site"]), np.eye(4)
    frame[:3, :3], frame[:3, 3] = of_quaternion(site.quat_wxyz), site.pos_m
    return frame_of(root) @ frame
