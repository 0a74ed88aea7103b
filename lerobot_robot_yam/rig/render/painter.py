"""Rendering of a model's cameras with software OpenGL, cheap enough for three cameras beside a control loop.

Only a process that set MUJOCO_GL before importing mujoco may import this module, as `renderer` does.
"""

import math
from collections.abc import Sequence

import cv2
import mujoco
import numpy as np

from lerobot_robot_yam.errors import RigError
from lerobot_robot_yam.rig.render.shade import Shade

# Measured: 12 slices, 2 stacks, no shadow maps and no multisampling take a quarter of the time of MuJoCo's defaults.
_SLICES, _STACKS = 12, 2
_BALL_STACKS = 6  # stacks for a model with balls, which two stacks would render as octahedra
_SPHERE, _ELLIPSOID = mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_ELLIPSOID
_PLANE, _BOX = mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_BOX
_CORNERS = np.array([[-1.0, -1.0, 1.0, 1.0], [-1.0, 1.0, -1.0, 1.0], [-1.0] * 4])  # right, up, backward
_SMALLEST = (320, 240)
_MAX_GEOMS = 400
_VISUAL_GROUPS = (0, 2)  # visible groups; collision shapes are in group 3, sites in group 4
_HIDDEN_GROUP, _UNSEEN_GROUP = 5, 4


class Painter:
    """Renderer of one model's cameras into RGB arrays. Uses one thread, one OpenGL context and one offscreen buffer.

    Args:
        model: the world; its visual quality settings are overwritten.
        hidden: name prefixes of the bodies (leaders) that `paint` omits unless `show_hidden` is set.

    Raises:
        RigError: no OpenGL context can be created.
    """

    def __init__(self, model: mujoco.MjModel, hidden: Sequence[str] = ()):
        self.model = model
        self.data = mujoco.MjData(model)
        quality = model.vis.quality
        balls = bool(np.isin(model.geom_type, (_SPHERE, _ELLIPSOID)).any())
        quality.numslices, quality.numstacks = _SLICES, _BALL_STACKS if balls else _STACKS
        quality.offsamples = quality.shadowsize = 0
        width, height = _SMALLEST
        model.vis.global_.offwidth, model.vis.global_.offheight = width, height
        _regroup(model, hidden)
        self._groups = model.geom_group.copy()
        self._sights: dict[tuple[int, float], Sight] = {}
        try:
            self._gl = mujoco.GLContext(width, height)
            self._gl.make_current()
            self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        except Exception as error:  # OpenGL backends raise various errors, including plain Exception
            raise RigError(
                f"rendered cameras need OpenGL through EGL, which failed ({error}); install a software one "
                "(Debian and Ubuntu: libegl1 libgl1-mesa-dri) or run without rendered cameras"
            ) from error
        self._shade = Shade(model, self._context)
        self._shaded: bool | None = None  # whether the latest shadows include hidden bodies; None: outdated
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._scene = mujoco.MjvScene(model, _MAX_GEOMS)
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self._scene.flags[flag] = 0
        self._option = mujoco.MjvOption()
        self._option.geomgroup[:] = [int(group in _VISUAL_GROUPS) for group in range(mujoco.mjNGROUP)]
        self._option.sitegroup[:] = 0
        self._raw: dict[tuple[int, int], np.ndarray] = {}

    def pose(self, qpos: np.ndarray) -> None:
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        self._shaded = None

    def paint(self, camera: str, out: np.ndarray, show_hidden: bool = False) -> None:
        """Render one camera of the model into `out`, (height, width, 3) uint8 RGB, top row first."""
        height, width, _ = out.shape
        context = self._context
        if width > context.offWidth or height > context.offHeight:  # no larger than needed, because clearing takes time
            mujoco.mjr_resizeOffscreen(max(width, context.offWidth), max(height, context.offHeight), context)
        if self._shaded is not show_hidden:
            groups = (*_VISUAL_GROUPS, _HIDDEN_GROUP) if show_hidden else _VISUAL_GROUPS
            self._shade.draw(self.data, groups)
            self._shaded = show_hidden
        view = mujoco.MjvCamera()
        view.type, view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, self.model.camera(camera).id
        raw = self._raw.setdefault((height, width), np.empty((height, width, 3), np.uint8))
        self._option.geomgroup[_HIDDEN_GROUP] = int(show_hidden)
        key = (view.fixedcamid, width / height)
        if key not in self._sights:
            self._sights[key] = Sight(self.model, *key)
        seen, sky = self._sights[key].seen(self.data)
        self.model.geom_group[~seen] = _UNSEEN_GROUP
        mujoco.mjv_updateScene(self.model, self.data, self._option, None, view, mujoco.mjtCatBit.mjCAT_ALL, self._scene)
        self.model.geom_group[:] = self._groups
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = int(sky)
        viewport = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(viewport, self._scene, context)
        mujoco.mjr_readPixels(raw, None, viewport, context)
        cv2.flip(raw, 0, dst=out)

    def close(self) -> None:
        self._context.free()
        self._gl.free()


def _regroup(model: mujoco.MjModel, hidden: Sequence[str]) -> None:
    """Move the visible shapes of bodies with one of these prefixes to the hidden group."""
    for geom in range(model.ngeom):
        name = model.body(model.geom_bodyid[geom]).name
        if model.geom_group[geom] in _VISUAL_GROUPS and name.startswith(tuple(hidden)):
            model.geom_group[geom] = _HIDDEN_GROUP


class Sight:
    """Visibility of shapes for one camera, whose images all have the aspect ratio `aspect` (width / height)."""

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
        self._sides = np.array([np.divide(side, np.linalg.norm(side)) for side in sides]).T  # outward normals

    def seen(self, data: mujoco.MjData) -> tuple[np.ndarray, bool]:
        """Return which shapes may be visible, (ngeom,) bool, and whether the sky may be visible."""
        eye, turn = data.cam_xpos[self._camera], data.cam_xmat[self._camera].reshape(3, 3)
        outside_m = ((data.geom_xpos - eye) @ (turn @ self._sides)).max(axis=1)
        within = outside_m <= self._radius
        if self._is_filled(data, eye, turn):
            return within & ~self._plane, False
        return within, True

    def _is_filled(self, data: mujoco.MjData, eye: np.ndarray, turn: np.ndarray) -> bool:
        """Return whether the top of the largest box fills the image, hiding floor and sky.

        The image corners are at  o + t d  with depth t.
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
