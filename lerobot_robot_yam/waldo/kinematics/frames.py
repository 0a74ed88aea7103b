"""Poses as commands give them: six numbers in mm and degrees, in a frame, alone or on top of where the tool is."""

from collections.abc import Sequence

import numpy as np

from lerobot_robot_yam.errors import PlanError
from lerobot_robot_yam.waldo.kinematics.rotation import of_vector, to_vector

FRAMES = ("WRF", "TRF")
"""The frame of the arm's base, and that of the tool."""
AXES = ("X", "Y", "Z", "RX", "RY", "RZ")

_UNITS = np.array([1e-3] * 3 + [np.pi / 180.0] * 3)


def check_frame(frame: str) -> str:
    """`frame`, if there is one of this name. Raises PlanError: there is not."""
    if frame not in FRAMES:
        raise PlanError(f"there is no frame {frame!r}; frames are {' and '.join(FRAMES)}")
    return frame


def commanded(now: np.ndarray, pose: Sequence[float] | np.ndarray, frame: str = "WRF", rel: bool = False) -> np.ndarray:
    """The pose (4, 4), m, that a command means.

    In the tool's frame it is seen from where the tool is, with and without `rel`. In the base's frame with `rel` the
    tool is shifted along the base's axes and turned about them, in place.

    Args:
        now: (4, 4) where the tool is, m.
        pose: x y z rx ry rz (6,), mm and degrees.

    Raises:
        PlanError: not six finite numbers, or no such frame.
    """
    meant = of_command(pose)
    if check_frame(frame) == "TRF":
        return now @ meant
    if not rel:
        return meant
    out = now.copy()
    out[:3, :3], out[:3, 3] = meant[:3, :3] @ now[:3, :3], now[:3, 3] + meant[:3, 3]
    return out


def of_command(pose: Sequence[float] | np.ndarray) -> np.ndarray:
    """(4, 4), m, of x y z rx ry rz (6,), mm and degrees. Raises PlanError: not six finite numbers."""
    return of_vector(np.multiply(_six(pose), _UNITS))


def to_command(pose: np.ndarray) -> np.ndarray:
    """x y z rx ry rz (…, 6), mm and degrees, of poses (…, 4, 4), m."""
    return to_vector(pose) / _UNITS


def _six(pose: Sequence[float] | np.ndarray) -> np.ndarray:
    try:
        given = np.array(pose, dtype=float)
    except (TypeError, ValueError):
        given = np.zeros(0)
    if given.shape != (6,):
        raise PlanError(f"a pose takes six numbers, x y z in mm and rx ry rz in degrees; not {pose!r}")
    return given
