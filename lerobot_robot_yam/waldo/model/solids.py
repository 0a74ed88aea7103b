"""Shapes of a profile as triangles, and triangles as STL: the only form in which Commander shows anything.

trimesh would do it, but is no dependency of this package.
"""

import numpy as np

from lerobot_robot_yam.arm.profile import Shape
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.waldo.kinematics.rotation import of_quaternion

_SECTIONS = 32  # of a circle
_RINGS = 9  # of a hemisphere

_STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_BOX_SIDES = (  # corners, numbered x + 2 y + 4 z, against the clock seen from outside
    (0, 2, 3, 1),
    (4, 5, 7, 6),
    (0, 1, 5, 4),
    (2, 6, 7, 3),
    (0, 4, 6, 2),
    (1, 3, 7, 5),
)


def triangles(shape: Shape) -> np.ndarray:
    """(m, 3, 3) corners, against the clock seen from outside, in the frame of the shape's body, m.

    Raises:
        ConfigError: an unknown kind of shape.
    """
    if shape.kind in ("cylinder", "capsule"):
        axis = shape.to_m - shape.from_m
        length = float(np.linalg.norm(axis))
        return shape.from_m + _revolved(_outline(shape.kind, shape.radius_m, length)) @ _frame_along(axis / length)
    turn = of_quaternion(shape.quat_wxyz).T
    if shape.kind == "box":
        corners = np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)]) - 0.5
        quads = (corners * shape.size_m)[np.array(_BOX_SIDES)]
        return shape.center_m + np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]) @ turn
    if shape.kind == "ellipsoid":
        ball = _revolved(_outline("capsule", 0.5, 0.0))
        return shape.center_m + (ball * shape.size_m) @ turn
    raise ConfigError(f"a shape of kind '{shape.kind}' cannot be drawn")


def stl(corners: np.ndarray) -> bytes:
    """A binary STL file of triangles (m, 3, 3), in their own unit."""
    rows = np.zeros(len(corners), _STL)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    rows["normal"] = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    rows["corners"] = corners
    return bytes(80) + len(rows).to_bytes(4, "little") + rows.tobytes()


def _outline(kind: str, radius: float, length: float) -> np.ndarray:
    """(k, 2) distance from the axis and height, from the lower end of the axis to the upper one."""
    if kind == "cylinder":
        return np.array([[0.0, 0.0], [radius, 0.0], [radius, length], [0.0, length]])
    rise = np.linspace(-np.pi / 2, np.pi / 2, 2 * _RINGS)
    upper = np.arange(2 * _RINGS) >= _RINGS
    return np.stack([radius * np.cos(rise), radius * np.sin(rise) + length * upper], axis=1)


def _revolved(outline: np.ndarray) -> np.ndarray:
    """(m, 3, 3) triangles of a body of revolution about z."""
    turn = np.arange(_SECTIONS + 1) * 2.0 * np.pi / _SECTIONS
    around = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    rings = np.empty((len(outline), len(turn), 3))
    rings[..., :2] = outline[:, None, :1] * around
    rings[..., 2] = outline[:, None, 1]
    low, high = rings[:-1], rings[1:]
    a, b, c, d = low[:, :-1], low[:, 1:], high[:, 1:], high[:, :-1]
    both = np.concatenate([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)]).reshape(-1, 3, 3)
    area = np.linalg.norm(np.cross(both[:, 1] - both[:, 0], both[:, 2] - both[:, 0]), axis=1)
    return both[area > 1e-12]  # at the ends of the axis one of the two has none


def _frame_along(axis: np.ndarray) -> np.ndarray:
    """(3, 3) rows of a right-handed frame whose third axis is `axis`, of length 1."""
    x = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(axis, x), axis])
