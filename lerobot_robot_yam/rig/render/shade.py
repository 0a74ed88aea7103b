"""Shadows on the table: the outline of every shape, slid along the light onto the sheet `scenery.SHADE`, softened.

Only the table is shaded, and whatever lies flat on it: things cast no shadow on each other.
"""

import cv2
import mujoco
import numpy as np
from OpenGL import GL

from lerobot_robot_yam.rig.world.scenery import SHADE

_PIXELS = (512, 320)  # along the table's x and y
_CORNERS = 20  # of an outline
_DARKNESS = 0.42  # of the light that reaches the table, under a light as bright as the scenes' first
_USUAL_LEVEL = 0.45
_DARKEST = 0.6
_BLUR_PIXELS = 5
_SUBPIXEL_BITS = 4
_ROUND = (mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_CAPSULE)


class Shade:
    """Draws the texture of the shadows that the model's first light casts. Its model has a geom `SHADE`."""

    def __init__(self, model: mujoco.MjModel, context: mujoco.MjrContext):
        self._model = model
        sheet = model.geom(SHADE).id
        self._sheet, self._texture = sheet, int(context.texture[model.texture(SHADE).id])
        kinds = (mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_ELLIPSOID, *_ROUND)
        self._solid = np.isin(model.geom_type, [int(kind) for kind in kinds])
        self._mask = np.zeros(_PIXELS[::-1], np.uint8)

    def draw(self, data: mujoco.MjData, groups: tuple[int, ...]) -> None:
        """Draw the shadows of all shapes of these groups, and give the texture to OpenGL."""
        model, sheet = self._model, self._sheet
        casting = np.flatnonzero(self._solid & np.isin(model.geom_group, groups))
        turn = data.geom_xmat[sheet].reshape(3, 3)
        center = (data.geom_xpos[casting] - data.geom_xpos[sheet]) @ turn  # in the sheet's frame
        casting, center = casting[center[:, 2] > 0.0], center[center[:, 2] > 0.0]
        light = turn.T @ data.light_xdir[0]
        slide = np.array([[1.0, 0.0, -light[0] / light[2]], [0.0, 1.0, -light[1] / light[2]]])
        axes = slide @ turn.T @ data.geom_xmat[casting].reshape(-1, 3, 3)
        outline = (center @ slide.T)[:, None] + _outlines(axes, model.geom_size[casting], model.geom_type[casting])
        self._fill(outline, model.geom_size[sheet][:2])
        level = float(model.light_diffuse[0].mean()) / _USUAL_LEVEL
        self._upload(cv2.convertScaleAbs(self._mask, alpha=min(_DARKEST, _DARKNESS * level)))

    def _upload(self, darkness: np.ndarray) -> None:
        """As a texture that only has opacity, which MuJoCo does not make, without smaller copies, which take longer."""
        GL.glBindTexture(GL.GL_TEXTURE_2D, self._texture)
        GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_MIN_FILTER, GL.GL_LINEAR)
        GL.glPixelStorei(GL.GL_UNPACK_ALIGNMENT, 1)
        size = (*_PIXELS, 0, GL.GL_ALPHA, GL.GL_UNSIGNED_BYTE)
        GL.glTexImage2D(GL.GL_TEXTURE_2D, 0, GL.GL_ALPHA, *size, darkness)

    def _fill(self, outlines: np.ndarray, half_m: np.ndarray) -> None:
        """Fill outlines (n, k, 2), m from the sheet's middle."""
        self._mask[:] = 0
        corners = (outlines / half_m * (1.0, -1.0) + 1.0) / 2.0 * _PIXELS - 0.5  # MuJoCo hangs textures upside down
        for polygon in np.round(corners * (1 << _SUBPIXEL_BITS)).astype(np.int32):
            cv2.fillConvexPoly(self._mask, polygon, 255, cv2.LINE_8, _SUBPIXEL_BITS)
        cv2.blur(self._mask, (_BLUR_PIXELS, _BLUR_PIXELS), self._mask)


def _outlines(axes: np.ndarray, sizes: np.ndarray, kinds: np.ndarray) -> np.ndarray:
    """Corners (n, k, 2) of convex shadows about their centres: the farthest point in each of k directions.

    axes: (n, 2, 3) shadows of each shape's unit axes. sizes, kinds: MuJoCo's.
    """
    angle = np.arange(_CORNERS) * (2 * np.pi / _CORNERS)
    direction = np.stack([np.cos(angle), np.sin(angle)])  # (2, k)
    toward = np.swapaxes(axes, 1, 2) @ direction  # (n, 3, k)
    box = np.sign(toward) * sizes[:, :, None]
    ball = sizes[:, :, None] ** 2 * toward
    ball /= np.linalg.norm(sizes[:, :, None] * toward, axis=1, keepdims=True) + 1e-12
    # Of a capsule size is (radius, half length, 0). Its round ends are taken for flat ones.
    disc = sizes[:, :1, None] * toward[:, :2] / (np.linalg.norm(toward[:, :2], axis=1, keepdims=True) + 1e-12)
    rod = np.concatenate([disc, np.sign(toward[:, 2:]) * sizes[:, 1:2, None]], axis=1)
    point = np.where((kinds == mujoco.mjtGeom.mjGEOM_BOX)[:, None, None], box, ball)
    point = np.where(np.isin(kinds, [int(kind) for kind in _ROUND])[:, None, None], rod, point)
    corners: np.ndarray = np.swapaxes(axes @ point, 1, 2)
    return corners
