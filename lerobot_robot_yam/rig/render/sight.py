"""What a camera of a model can see, so that nothing else is drawn."""

import math

import mujoco
import numpy as np

_PLANE, _BOX = mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_BOX


class Sight:
    """The shapes in the pictures of one model's cameras."""

    def __init__(self, model: mujoco.MjModel):
        self._model = model
        self._plane = model.geom_type == _PLANE
        self._radius = np.where(self._plane, np.inf, model.geom_rbound)
        area = np.where(model.geom_type == _BOX, model.geom_size[:, 0] * model.geom_size[:, 1], 0.0)
        self._table = int(area.argmax())
        self._near_m = model.vis.map.znear * model.stat.extent

    def seen(self, data: mujoco.MjData, camera: int, aspect: float) -> tuple[np.ndarray, bool]:
        """Shapes that may be in a picture, (ngeom,) bool, and whether the sky may be. aspect: width by height."""
        up = math.tan(math.radians(self._model.cam_fovy[camera]) / 2.0)
        half = np.array([aspect * up, up])
        eye, turn = data.cam_xpos[camera], data.cam_xmat[camera].reshape(3, 3)
        center = (data.geom_xpos - eye) @ turn  # right, up, backward
        outside_m = (np.abs(center[:, :2]) + center[:, 2:] * half) / np.sqrt(1.0 + half**2)
        within = outside_m.max(axis=1) <= self._radius
        if self._is_filled(data, eye, turn, half):
            return within & ~self._plane, False
        return within, True

    def _is_filled(self, data: mujoco.MjData, eye: np.ndarray, turn: np.ndarray, half: np.ndarray) -> bool:
        """Whether the top of the largest box fills a picture: floor and sky are behind it.

        A picture's corners are seen at  o + t d;  depth t, as d is of depth 1.
        """
        model, table = self._model, self._table
        own, half_m = data.geom_xmat[table].reshape(3, 3), model.geom_size[table]
        o = (eye - data.geom_xpos[table]) @ own - [0.0, 0.0, half_m[2]]
        d = np.array([(x * half[0], y * half[1], -1.0) for x in (-1, 1) for y in (-1, 1)]) @ turn.T @ own
        if o[2] <= 0.0 or (d[:, 2] >= 0.0).any() or model.geom_rgba[table, 3] < 1.0:
            return False
        t = -o[2] / d[:, 2]
        hits = o[:2] + t[:, None] * d[:, :2]
        return bool(t.min() > self._near_m and (np.abs(hits) < half_m[:2]).all())
