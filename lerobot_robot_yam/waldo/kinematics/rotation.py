"""Rotations as Commander writes them, and poses (4, 4) from and to its six numbers.

    R = Rx(rx) Ry(ry) Rz(rz)      intrinsic XYZ, rad

At ry = ±90° only rx ± rz is determined: rx is 0 there. A YAM arm that points forward is always at −90° or close to it.
"""

import math

import numpy as np

from lerobot_robot_yam.errors import PlanError

_LOCKED = 1e-7  # cos(ry), below which rx and rz turn about the same axis
_SMALL_RAD = 1e-9


def cross_matrix(vector: np.ndarray) -> np.ndarray:
    """(3, 3) K with K v = vector × v."""
    x, y, z = np.asarray(vector, dtype=float).tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """first × second (…, 3); numpy's own takes three times as long for a few vectors."""
    a, b = first[..., [1, 2, 0]] * second[..., [2, 0, 1]], first[..., [2, 0, 1]] * second[..., [1, 2, 0]]
    return a - b


def of_quaternion(wxyz: np.ndarray) -> np.ndarray:
    """(3, 3) of a quaternion w x y z, which need not be of length 1."""
    w, *xyz = (np.asarray(wxyz, dtype=float) / np.linalg.norm(wxyz)).tolist()
    k = cross_matrix(np.array(xyz))
    return np.eye(3) + 2.0 * w * k + 2.0 * k @ k


def of_angles(angles: np.ndarray) -> np.ndarray:
    """(…, 3, 3) of rx, ry, rz (…, 3) rad."""
    (cx, cy, cz), (sx, sy, sz) = np.moveaxis(np.cos(angles), -1, 0), np.moveaxis(np.sin(angles), -1, 0)
    rows = [
        [cy * cz, -cy * sz, sy],
        [cx * sz + sx * sy * cz, cx * cz - sx * sy * sz, -sx * cy],
        [sx * sz - cx * sy * cz, sx * cz + cx * sy * sz, cx * cy],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def to_angles(rotation: np.ndarray) -> np.ndarray:
    """rx, ry, rz (…, 3) rad of (…, 3, 3)."""
    r = np.asarray(rotation, dtype=float)
    level = np.hypot(r[..., 0, 0], r[..., 0, 1])
    locked = level < _LOCKED
    rx = np.where(locked, 0.0, np.arctan2(-r[..., 1, 2], r[..., 2, 2]))
    ry = np.arctan2(r[..., 0, 2], level)
    rz = np.where(locked, np.arctan2(r[..., 1, 0], r[..., 1, 1]), np.arctan2(-r[..., 0, 1], r[..., 0, 0]))
    return np.stack([rx, ry, rz], axis=-1)


def to_rpy(rotation: np.ndarray) -> np.ndarray:
    """roll, pitch, yaw (3,) rad of (3, 3), as URDF and tools have them: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    x, y, z = to_angles(np.asarray(rotation).T).tolist()  # R = Rx(x) Ry(y) Rz(z) turned round
    return np.array([-x, -y, -z])


def to_vector(pose: np.ndarray) -> np.ndarray:
    """x y z rx ry rz (…, 6), m and rad, of poses (…, 4, 4)."""
    return np.concatenate([pose[..., :3, 3], to_angles(pose[..., :3, :3])], axis=-1)


def of_vector(vector: np.ndarray) -> np.ndarray:
    """Poses (…, 4, 4) of x y z rx ry rz (…, 6), m and rad.

    Raises:
        PlanError: not six finite numbers.
    """
    try:
        given = np.array(vector, dtype=float)
    except (TypeError, ValueError):
        given = np.zeros(0)
    if given.shape[-1:] != (6,) or not np.isfinite(given).all():
        raise PlanError(f"a pose takes six finite numbers, x y z rx ry rz; not {vector!r}")
    pose = np.zeros((*given.shape[:-1], 4, 4))
    pose[..., :3, :3], pose[..., :3, 3], pose[..., 3, 3] = of_angles(given[..., 3:]), given[..., :3], 1.0
    return pose


def of_turn(turn: np.ndarray) -> np.ndarray:
    """(3, 3) of a rotation vector, axis times angle (3,) rad."""
    angle = float(np.linalg.norm(turn))
    if angle < _SMALL_RAD:
        return np.eye(3) + cross_matrix(turn)
    k = cross_matrix(turn / angle)
    return np.eye(3) + math.sin(angle) * k + (1.0 - math.cos(angle)) * (k @ k)


def to_turn(rotation: np.ndarray) -> np.ndarray:
    """Rotation vectors (…, 3) rad, of length π at most, of (…, 3, 3)."""
    r = rotation
    sine = 0.5 * np.stack(
        [r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0], r[..., 1, 0] - r[..., 0, 1]], axis=-1
    )
    cosine = 0.5 * (np.trace(r, axis1=-2, axis2=-1) - 1.0)
    length = np.sqrt(np.einsum("...i,...i", sine, sine))
    angle = np.arctan2(length, cosine)
    small = length < 1e-7
    turn = sine * np.where(small, 1.0, angle / np.where(small, 1.0, length))[..., None]
    half = small & (cosine < 0.0)  # half a turn: its axis is the longest column of R + 1, which is 2 a aᵀ
    if half.any():
        columns = np.swapaxes(r[half] + np.eye(3), -1, -2)
        longest = columns[np.arange(len(columns)), np.linalg.norm(columns, axis=-1).argmax(axis=-1)]
        turn[half] = np.pi * longest / np.linalg.norm(longest, axis=-1, keepdims=True)
    return turn
