"""Tool poses as six numbers: position, and rotation vector relative to "pointing straight down, facing forward".

    R = exp(r) R_down        r (3,): axis times angle, rad, in the axes of the arm's base

R_down is the tool's orientation at zero joints, pointing forward, turned by 90° so that the tool points straight down.
So r is small in table work: r_z is the tool's heading, r_x and r_y its tilt. At an angle of π (a tool that points
straight up or backward), two values of r describe the same rotation. LeRobot's rotation vector, relative to the base's
own axes, is near such an angle for every tool that points down.
"""

import mink
import mujoco
import numpy as np

from lerobot_robot_yam.arm.kinematics import YamKinematics
from lerobot_robot_yam.errors import ActionError

_TIP = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # 90° about y: from forward to down


def downward(kinematics: YamKinematics) -> np.ndarray:
    """Compute R_down (3, 3) for an arm's site."""
    return _TIP @ kinematics.fk(np.zeros_like(kinematics.lower))[:3, :3]


def pose_to_vector(pose: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Convert a pose (4, 4) to (6,): position, m, and rotation vector, rad, relative to `reference` (3, 3)."""
    return np.concatenate([pose[:3, 3], rotation_vector(pose[:3, :3] @ reference.T)])


def vector_to_pose(vector: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Convert (6,) to a pose (4, 4), the inverse of `pose_to_vector`; rotation angles above π are allowed.

    Raises:
        ActionError: the numbers are too large for a finite rotation.
    """
    pose = np.eye(4)
    pose[:3, :3] = rotation_matrix(vector[3:]) @ reference
    pose[:3, 3] = vector[:3]
    if not np.isfinite(pose).all():
        raise ActionError(f"end effector: {vector.tolist()} is no pose; nothing was sent")
    return pose


def rotation_vector(rotation: np.ndarray) -> np.ndarray:
    """Convert a rotation (3, 3) to axis times angle (3,), rad, at most π long.

    MuJoCo computes the vector, since mink's `SO3.log` returns zeros for an angle of exactly π.
    """
    quat, vector = np.empty(4), np.empty(3)
    mujoco.mju_mat2Quat(quat, rotation.ravel())
    mujoco.mju_quat2Vel(vector, quat, 1.0)
    return vector


def rotation_matrix(vector: np.ndarray) -> np.ndarray:
    """Convert a rotation vector (3,) rad to a matrix (3, 3)."""
    matrix: np.ndarray = mink.SO3.exp(vector).as_matrix()
    return matrix
