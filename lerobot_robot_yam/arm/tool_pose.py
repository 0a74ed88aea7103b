"""A tool pose as six numbers: position, and rotation vector from "pointing straight down, facing forward".

    R = exp(r) R_down        r (3,): axis times angle, rad, in the axes of the arm's base

R_down is the tool as it is with all joints at zero, where it points forward, tipped by a quarter turn until it points
straight down. So r is small in table work: r_z is the tool's heading, r_x and r_y its tilt. Two r describe the same
rotation where the angle is π, a tool that points straight up or backward; from LeRobot's rotation vector, which counts
from the base's own axes, a tool that points down is never far from there.
"""

import mink
import mujoco
import numpy as np

from lerobot_robot_yam.arm.kinematics import YamKinematics
from lerobot_robot_yam.errors import ActionError

_TIP = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # a quarter turn about y: forward to down


def downward(kinematics: YamKinematics) -> np.ndarray:
    """R_down (3, 3) of an arm's site."""
    return _TIP @ kinematics.fk(np.zeros_like(kinematics.lower))[:3, :3]


def pose_to_vector(pose: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """(6,) position, m, and rotation vector, rad, of a pose (4, 4) against a reference orientation (3, 3)."""
    return np.concatenate([pose[:3, 3], rotation_vector(pose[:3, :3] @ reference.T)])


def vector_to_pose(vector: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Inverse of `pose_to_vector`; angles beyond π are taken for what they are.

    Raises:
        ActionError: numbers so large that they mean no rotation.
    """
    pose = np.eye(4)
    pose[:3, :3] = rotation_matrix(vector[3:]) @ reference
    pose[:3, 3] = vector[:3]
    if not np.isfinite(pose).all():
        raise ActionError(f"end effector: {vector.tolist()} is no pose; nothing was sent")
    return pose


def rotation_vector(rotation: np.ndarray) -> np.ndarray:
    """(3,) axis times angle, rad, of length π at most, of a rotation (3, 3).

    Not by mink's `SO3.log`, which gives zeros for exactly half a turn.
    """
    quat, vector = np.empty(4), np.empty(3)
    mujoco.mju_mat2Quat(quat, rotation.ravel())
    mujoco.mju_quat2Vel(vector, quat, 1.0)
    return vector


def rotation_matrix(vector: np.ndarray) -> np.ndarray:
    """(3, 3) of a rotation vector (3,) rad."""
    matrix: np.ndarray = mink.SO3.exp(vector).as_matrix()
    return matrix
