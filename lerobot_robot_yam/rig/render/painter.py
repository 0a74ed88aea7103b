"""Pictures of a MuJoCo world through software OpenGL, cheap enough for three cameras beside a control loop.

Only a process that set MUJOCO_GL before importing mujoco may use this, as `renderer` does.
"""

from collections.abc import Sequence

import mujoco
import numpy as np

from lerobot_robot_yam.errors import RigError

# Measured here: 12 slices, 6 stacks, no shadows and no multisampling cost a third of MuJoCo's defaults.
_SLICES, _STACKS = 12, 6
_SMALLEST = (320, 240)
_MAX_GEOMS = 400
_VISUAL_GROUPS = (0, 2)  # collision shapes are in 3, sites in 4
_HIDDEN_GROUP = 5


class Painter:
    """Renders cameras of one model into RGB arrays. One thread, one OpenGL context, one offscreen buffer.

    Args:
        model: the world; its visual quality settings are overwritten.
        hidden: prefixes of bodies that are left out, with all they carry (leaders, which no camera is for).

    Raises:
        RigError: no OpenGL context can be made.
    """

    def __init__(self, model: mujoco.MjModel, hidden: Sequence[str] = ()):
        self.model = model
        self.data = mujoco.MjData(model)
        quality = model.vis.quality
        quality.numslices, quality.numstacks = _SLICES, _STACKS
        quality.offsamples = quality.shadowsize = 0
        width, height = _SMALLEST
        model.vis.global_.offwidth, model.vis.global_.offheight = width, height
        _regroup(model, hidden)
        try:
            self._gl = mujoco.GLContext(width, height)
            self._gl.make_current()
            self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        except Exception as error:  # each OpenGL backend raises other errors, some of them plain Exception
            raise RigError(
                f"rendered cameras need OpenGL through EGL, which failed ({error}); install a software one "
                "(Debian and Ubuntu: libegl1 libgl1-mesa-dri) or run without rendered cameras"
            ) from error
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._scene = mujoco.MjvScene(model, _MAX_GEOMS)
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self._scene.flags[flag] = 0
        self._option = mujoco.MjvOption()
        self._option.geomgroup[:] = [int(group in _VISUAL_GROUPS) for group in range(mujoco.mjNGROUP)]
        self._option.sitegroup[:] = 0
        self._views: dict[str, mujoco.MjvCamera] = {}
        self._raw: dict[tuple[int, int], np.ndarray] = {}

    def pose(self, qpos: np.ndarray) -> None:
        """Take a state, (nq,)."""
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)

    def paint(self, camera: str, out: np.ndarray, show_hidden: bool = False) -> None:
        """Render one camera of the model into out, (height, width, 3) uint8 RGB, first row on top."""
        height, width, _ = out.shape
        context = self._context
        if width > context.offWidth or height > context.offHeight:  # no larger than needed: clearing it costs time
            mujoco.mjr_resizeOffscreen(max(width, context.offWidth), max(height, context.offHeight), context)
        view = self._views.get(camera)
        if view is None:
            view = mujoco.MjvCamera()
            view.type = mujoco.mjtCamera.mjCAMERA_FIXED
            view.fixedcamid = self.model.camera(camera).id
            self._views[camera] = view
        raw = self._raw.setdefault((height, width), np.empty((height, width, 3), np.uint8))
        self._option.geomgroup[_HIDDEN_GROUP] = int(show_hidden)
        mujoco.mjv_updateScene(self.model, self.data, self._option, None, view, mujoco.mjtCatBit.mjCAT_ALL, self._scene)
        viewport = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(viewport, self._scene, context)
        mujoco.mjr_readPixels(raw, None, viewport, context)
        np.copyto(out, raw[::-1])

    def close(self) -> None:
        """Give the OpenGL context back."""
        self._context.free()
        self._gl.free()


def _regroup(model: mujoco.MjModel, hidden: Sequence[str]) -> None:
    """Move the visible shapes of bodies whose names begin with one of `hidden` into another group."""
    for geom in range(model.ngeom):
        name = model.body(model.geom_bodyid[geom]).name
        if model.geom_group[geom] in _VISUAL_GROUPS and name.startswith(tuple(hidden)):
            model.geom_group[geom] = _HIDDEN_GROUP
