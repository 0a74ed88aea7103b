"""Checked numbers from commands, and poses as six numbers: x y z rx ry rz, absolute or relative, in base or tool frame.

    R = Rx(rx) Ry(ry) Rz(rz)      intrinsic XYZ

At ry = ±90° (gimbal lock) only rx ± rz is determined, and rx is set to 0. A YAM arm that points forward is always at
or close to ry = −90°.
"""

from collections.abc import Sequence
from numbers import Real

import mink
import numpy as np

from lerobot_robot_yam.errors import PlanError

FRAMES = ("WRF", "TRF")
"""Commander's names of the base frame and the tool frame."""
AXES = ("X", "Y", "Z", "RX", "RY", "RZ")

Numbers = Sequence[float] | np.ndarray

_UNITS = np.array([1e-3] * 3 + [np.pi / 180.0] * 3)  # units of poses in commands (mm, degrees), in m and rad
_LOCKED = 1e-7  # cos(ry) below which a pose counts as in gimbal lock


def numbers(what: str, values: object, count: int) -> np.ndarray:
    """Return `values` as an array (count,) of finite floats. Raises PlanError if that is not possible."""
    try:
        given = np.array(values, dtype=float)
    except (TypeError, ValueError):
        given = np.zeros(0)
    if given.shape != (count,) or not np.isfinite(given).all():
        raise PlanError(f"{what} takes {count} finite numbers, not {values!r}")
    return given


def number(what: str, value: object, low: float, high: float) -> float:
    """Return `value` as a float, checked to lie in [low, high]. Raises PlanError otherwise."""
    if not (isinstance(value, Real) and low <= float(value) <= high):
        raise PlanError(f"{what} has to be a number from {low:g} to {high:g}, not {value!r}")
    return float(value)


def check_frame(frame: str) -> str:
    """Return `frame` unchanged. Raises PlanError if it is not in `FRAMES`."""
    if frame not in FRAMES:
        raise PlanError(f"there is no frame {frame!r}; frames are {' and '.join(FRAMES)}")
    return frame


def commanded(now: np.ndarray, pose: Numbers, frame: str = "WRF", rel: bool = False) -> np.ndarray:
    """Return the target pose (4, 4), m, of a command.

    In the tool frame, the numbers are relative to the tool, with or without `rel`. In the base frame with `rel`, the
    tool is shifted along the base axes, and rotated in place about axes parallel to them.

    Args:
        now: (4, 4) current pose of the tool, m.
        pose: x y z rx ry rz (6,), mm and degrees.

    Raises:
        PlanError: `pose` is not six finite numbers, or `frame` is unknown.
    """
    meant = from_command(pose)
    if check_frame(frame) == "TRF":
        return now @ meant
    if not rel:
        return meant
    out = now.copy()
    out[:3, :3], out[:3, 3] = meant[:3, :3] @ now[:3, :3], now[:3, 3] + meant[:3, 3]
    return out


def from_command(pose: Numbers) -> np.ndarray:
    """Convert x y z rx ry rz (6,), mm and degrees, to a pose (4, 4), m. Raises PlanError: not six finite numbers."""
    return from_vector(numbers("a pose, x y z in mm and rx ry rz in degrees,", pose, 6) * _UNITS)


def to_command(pose: np.ndarray) -> np.ndarray:
    """Convert poses (…, 4, 4), m, to x y z rx ry rz (…, 6), mm and degrees."""
    return to_vector(pose) / _UNITS


def from_vector(vector: Numbers) -> np.ndarray:
    """Convert x y z rx ry rz (6,), m and rad, to a pose (4, 4), m. Raises PlanError: not six finite numbers."""
    x, y, z, rx, ry, rz = numbers("a pose, x y z rx ry rz,", vector, 6).tolist()
    pose = np.eye(4)
    turn = mink.SO3.from_x_radians(rx) @ mink.SO3.from_y_radians(ry) @ mink.SO3.from_z_radians(rz)
    pose[:3, :3], pose[:3, 3] = turn.as_matrix(), (x, y, z)
    return pose


def to_vector(pose: np.ndarray) -> np.ndarray:
    """Convert poses (…, 4, 4), m, to x y z rx ry rz (…, 6), m and rad."""
    r = pose[..., :3, :3]
    level = np.hypot(r[..., 0, 0], r[..., 0, 1])
    locked = level < _LOCKED
    rx = np.where(locked, 0.0, np.arctan2(-r[..., 1, 2], r[..., 2, 2]))
    ry = np.arctan2(r[..., 0, 2], level)
    rz = np.where(locked, np.arctan2(r[..., 1, 0], r[..., 1, 1]), np.arctan2(-r[..., 0, 1], r[..., 0, 0]))
    return np.concatenate([pose[..., :3, 3], np.stack([rx, ry, rz], axis=-1)], axis=-1)
