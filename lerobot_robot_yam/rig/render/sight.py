"""What a camera of a model can see, so that nothing else is drawn."""

import math

import mujoco
import numpy as np

_PLANE, _BOX = mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_BOX
_CORNERS = np.array([[-1.0, -1.0, 1.0, 1.0], [-1.0, 1.0, -1.0, 1.0], [-1.0] * 4])  # right, up, backward


class Sight:
    """The shapes in the pictures of one camera, all of `aspect` (width by height)."""

    def __init__(self, model: mujoco.MjModel, camera: int, aspect: float):
        self._model, self._camera = model, camera
        self._plane = model.geom_type == _PLANE
        self._radius = np.where(self._plane, np.inf, model.geom_rbound)
        area = np.where(model.geom_type == _BOX, model.geom_size[:, 0] * model.geom_size[:, 1], 0.0)
        self._table = int(area.argmax())
        self._near_m = model.vis.map.znear * model.stat.extent
        up = math.tan(math.radians(model.cam_fovy[camera]) / 2.0)
        self._corners = _CORNERS * [[aspect * up], [up], [1.0]]
        sides = [(sign, 0.0, aspect * up) for sign in (-1.0, 1.0)] + [(0.0, sign, up) for sign in (-1.0, 1.0)]
        self._sides = np.array([np.divide(side, np.linalg.norm(side)) for side in sides]).T  # they point outward

    def seen(self, data: mujoco.MjData) -> tuple[np.ndarray, bool]:
        """Shapes that may be in the picture, (ngeom,) bool, and whether the sky may be."""
        eye, turn = data.cam_xpos[self._camera], data.cam_xmat[self._camera].reshape(3, 3)
        outside_m = ((data.geom_xpos - eye) @ (turn @ self._sides)).max(axis=1)
        within = outside_m <= self._radius
        if self._is_filled(data, eye, turn):
            return within & ~self._plane, False
        return within, True

    def _is_filled(self, data: mujoco.MjData, eye: np.ndarray, turn: np.ndarray) -> bool:
        """Whether the top of the largest box fills the picture: floor and sky are behind it.

        The picture's corners are seen at  o + t d;  t is their depth.
        """
        model, table = self._model, self._table
        own, half_m = data.geom_xmat[table].reshape(3, 3).T, model.geom_size[table]
        o, d = own @ (eye - data.geom_xpos[table]), own @ turn @ self._corners
        height = o[2] - half_m[2]
        if height <= 0.0 or d[2].max() >= 0.0 or model.geom_rgba[table, 3] < 1.0:
            return False
        t = -height / d[2]
        hits = np.abs(o[:2, None] + t * d[:2]).max(axis=1)
        return bool(t.min() > self._near_m and hits[0] < half_m[0] and hits[1] < half_m[1])
