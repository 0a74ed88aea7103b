"""Triangle meshes of primitives, centred at the origin. trimesh would add a third to the start-up time of yam-view."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

_SECTIONS = 24  # segments of a circle
_RINGS = 7  # points on a quarter circle, including pole and equator
_POLE = 1e-9  # radius below which a ring counts as one point, m
_BOX_SIDES = np.array(  # corner numbers of each side; number = x + 2 y + 4 z
    [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
)


class Mesh(NamedTuple):
    """Triangle mesh: vertices (n, 3) in m; faces (m, 3) as vertex indices, counter-clockwise seen from outside."""

    vertices: np.ndarray
    faces: np.ndarray

    def scaled(self, factors: Sequence[float] | np.ndarray) -> "Mesh":
        """Return a copy scaled along x, y and z."""
        return self._replace(vertices=self.vertices * np.asarray(factors))

    def moved(self, turn: np.ndarray, offset_m: np.ndarray) -> "Mesh":
        """Return a copy rotated by `turn` (3, 3) about the origin, then shifted by offset_m (3,)."""
        return self._replace(vertices=self.vertices @ turn.T + offset_m)


def box(size_m: Sequence[float] | np.ndarray) -> Mesh:
    """Create a box with the edge lengths size_m (3)."""
    corners = np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)]) - 0.5
    faces = np.concatenate([_BOX_SIDES[:, [0, 1, 2]], _BOX_SIDES[:, [0, 2, 3]]])
    return Mesh(corners, faces).scaled(size_m)


def cylinder(radius_m: float, length_m: float) -> Mesh:
    """Create a cylinder along z."""
    half = length_m / 2
    return _revolved(np.array([[0.0, -half], [radius_m, -half], [radius_m, half], [0.0, half]]))


def capsule(radius_m: float, length_m: float) -> Mesh:
    """Create a capsule along z: a cylinder of length length_m with a hemisphere at each end."""
    lower, upper = _arc(-np.pi / 2, 0.0, _RINGS), _arc(0.0, np.pi / 2, _RINGS)
    middle = [0.0, length_m / 2]
    return _revolved(np.concatenate([radius_m * lower - middle, radius_m * upper + middle]))


def ball() -> Mesh:
    """Create a sphere with a radius of 1 m."""
    return _revolved(_arc(-np.pi / 2, np.pi / 2, 2 * _RINGS - 1))


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """Join meshes to one mesh."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))


def _arc(first_rad: float, last_rad: float, points: int) -> np.ndarray:
    """Compute points (points, 2) on the unit circle."""
    angles = np.linspace(first_rad, last_rad, points)
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def _revolved(outline: np.ndarray) -> Mesh:
    """Create a body of revolution about z. outline: (k, 2) radius and height, from the lower to the upper pole."""
    around = _arc(0.0, 2.0 * np.pi, _SECTIONS + 1)[:-1]
    vertices = np.empty((len(outline), _SECTIONS, 3))
    vertices[..., :2] = outline[:, None, :1] * around
    vertices[..., 2] = outline[:, None, 1]
    number = np.arange(len(outline) * _SECTIONS).reshape(len(outline), _SECTIONS)
    poles = outline[:, 0] < _POLE
    number[poles] = number[poles, :1]
    low, high = number[:-1], number[1:]
    next_low, next_high = np.roll(low, -1, axis=1), np.roll(high, -1, axis=1)
    halves = np.stack([low, next_low, next_high], axis=-1), np.stack([low, next_high, high], axis=-1)
    faces = np.concatenate(halves).reshape(-1, 3)
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]  # at a pole, one of the two triangles is degenerate
    used, faces = np.unique(faces, return_inverse=True)
    return Mesh(vertices.reshape(-1, 3)[used], faces.reshape(-1, 3))
