"""Grain and shadows of a scene's table: outlines of shapes are projected along the light onto the table and softened.

Only the table and flat things on it receive shadows; other things do not. MuJoCo's shadow maps shade all things, but
with shadow maps a frame takes three to four times as long on software OpenGL.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import mujoco
import numpy as np
from OpenGL import GL

from lerobot_robot_yam.rig.world.world_model import FLAT, TABLE

_TABLE_PIXELS, _FLAT_PIXELS = (1024, 640), (96, 96)  # size of the textures along x and y
_CORNERS = 20  # number of corners of an outline
_ANGLES = np.arange(_CORNERS) * (2 * np.pi / _CORNERS) + 0.01  # offset: hits a box's corners, not its sides' middles
_DIRECTIONS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)])  # (2, k)
_DARKNESS, _DARKEST = 0.42, 0.6  # fraction of brightness that a shadow removes: at `_USUAL_LEVEL`, and maximum
_USUAL_LEVEL = 0.45
_SOFT_M = 0.016  # width of the soft edge of a shadow
_SUBPIXEL_BITS = 4
_PLANK_M = 0.175  # width of a plank of the table, along x
_LEVEL = 224.0  # mean grey level; the table's colour is multiplied by level / 255
_TONE, _GRAIN, _SEAM = 6.0, 11.0, 38.0  # grey levels: sigma between planks, sigma within a plank, darkening at seams
_BOX = mujoco.mjtGeom.mjGEOM_BOX
_NOWHERE = np.zeros((2, 2), int)
_ROUND = (mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_CAPSULE)
_SOLID = (_BOX, *_ROUND, mujoco.mjtGeom.mjGEOM_ELLIPSOID)


@dataclass
class _Surface:
    """Top of a box with a shaded texture.

    Attributes:
        geom: index of the box in the model.
        texture: OpenGL name of the texture.
        bright: (height, width) uint8, texture without shadows.
        shaded: minimum and maximum x, y of the area that the last shadows covered, pixels of a mask; (2, 2).
    """

    geom: int
    texture: int
    bright: np.ndarray
    shaded: np.ndarray


class Shade:
    """Textures with shadows for all surfaces that `world_model.add_shaded_surfaces` has marked, if any."""

    def __init__(self, model: mujoco.MjModel, context: mujoco.MjrContext):
        self._model = model
        self._box, self._rod = (np.isin(model.geom_type, [int(kind) for kind in some]) for some in ((_BOX,), _ROUND))
        self._solid = np.isin(model.geom_type, [int(kind) for kind in _SOLID])
        self._casting: dict[tuple[int, ...], np.ndarray] = {}  # groups → indices of their shapes
        self._surfaces = list(_surfaces(model, context))
        cv2.setNumThreads(1)  # leaves the other processor to physics and control

    def draw(self, data: mujoco.MjData, groups: tuple[int, ...]) -> None:
        """Draw the shadows of all shapes in these groups, cast by the model's first light."""
        model = self._model
        if groups not in self._casting:
            self._casting[groups] = np.flatnonzero(self._solid & np.isin(model.geom_group, groups))
        casting = self._casting[groups]
        darkness = min(_DARKEST, _DARKNESS * float(model.light_diffuse[0].mean()) / _USUAL_LEVEL)
        for surface in self._surfaces:
            half_m = model.geom_size[surface.geom]
            turn = data.geom_xmat[surface.geom].reshape(3, 3)
            center = (data.geom_xpos[casting] - data.geom_xpos[surface.geom]) @ turn - [0.0, 0.0, half_m[2]]
            above = center[:, 2] > 0.0
            shapes = casting[above]
            light = data.light_xdir[0] @ turn
            slide = np.array([[1.0, 0.0, -light[0] / light[2]], [0.0, 1.0, -light[1] / light[2]]])
            axes = slide @ turn.T @ data.geom_xmat[shapes].reshape(-1, 3, 3)
            outlines = _outlines(axes, model.geom_size[shapes], self._box[shapes], self._rod[shapes])
            outlines += (center[above] @ slide.T)[:, None]
            height, width = surface.bright.shape
            pixels = np.array([width, height]) // 2  # half the resolution is sufficient for soft shadows
            corners = (outlines / half_m[:2] * (1.0, -1.0) + 1.0) / 2.0 * pixels - 0.5  # first row: largest y
            soft = np.maximum(1, np.round(_SOFT_M * pixels / (2.0 * half_m[:2]))).astype(int)
            touched = _touched(corners, soft, pixels)
            low, high = area = _union(touched, surface.shaded)
            surface.shaded = touched
            if (high <= low).any():
                continue
            mask = _filled(corners - low, soft, high - low)
            lit = cv2.resize(cv2.convertScaleAbs(mask, alpha=-darkness, beta=255.0), (2 * (high - low)).tolist())
            rows, columns = (slice(*(2 * area[:, axis])) for axis in (1, 0))
            _upload(surface.texture, 2 * low, cv2.multiply(surface.bright[rows, columns], lit, scale=1 / 255))


def _surfaces(model: mujoco.MjModel, context: mujoco.MjrContext) -> Iterator[_Surface]:
    for geom, material in enumerate(model.geom_matid):
        name = "" if material < 0 else model.material(material).name
        if name == TABLE:
            bright = _grain(_TABLE_PIXELS, 2.0 * float(model.geom_size[geom][1]))
        elif name.startswith(FLAT):
            bright = np.full(_FLAT_PIXELS[::-1], 255, np.uint8)
        else:
            continue
        texture = int(context.texture[model.texture(name).id])
        _begin(texture, bright)
        yield _Surface(geom, texture, bright, _NOWHERE)


def _grain(pixels: tuple[int, int], width_m: float) -> np.ndarray:
    """Return a table's fixed grain, (height, width) uint8. pixels: along x and y. width_m: table width along y."""
    width, height = pixels
    random = np.random.default_rng(7)
    planks = max(1, round(width_m / _PLANK_M))
    plank = np.arange(height) * planks // height
    fine, coarse = random.normal(size=(height, width)), random.normal(size=(height, width))
    tone = _TONE * random.normal(size=planks)[plank][:, None]
    streaks = _along(_along(fine, width // 6).T, 2).T + 0.8 * _along(_along(coarse, width // 3).T, 7).T
    level = _LEVEL + tone + _GRAIN * streaks / streaks.std()
    level[np.flatnonzero(np.diff(plank, prepend=0))] -= _SEAM
    return np.clip(level, 0, 255).astype(np.uint8)


def _along(noise: np.ndarray, length: int) -> np.ndarray:
    """Return the moving average over `length` samples along cyclic rows, scaled to standard deviation 1."""
    padded = np.concatenate([noise, noise[:, : length - 1]], axis=1)
    total = np.cumsum(np.pad(padded, ((0, 0), (1, 0))), axis=1)
    mean: np.ndarray = (total[:, length:] - total[:, :-length]) / length
    return mean / mean.std()


def _begin(texture: int, bright: np.ndarray) -> None:
    """Create a one-channel texture without mipmaps; `mjr_uploadTexture`, which creates mipmaps, takes 5 ms."""
    height, width = bright.shape
    GL.glBindTexture(GL.GL_TEXTURE_2D, texture)
    GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_MIN_FILTER, GL.GL_LINEAR)
    GL.glPixelStorei(GL.GL_UNPACK_ALIGNMENT, 1)
    kind = (GL.GL_LUMINANCE, GL.GL_UNSIGNED_BYTE)
    GL.glTexImage2D(GL.GL_TEXTURE_2D, 0, GL.GL_LUMINANCE, width, height, 0, *kind, bright)


def _upload(texture: int, at: np.ndarray, bright: np.ndarray) -> None:
    """Replace the part of a texture that starts at column and row `at`."""
    height, width = bright.shape
    GL.glBindTexture(GL.GL_TEXTURE_2D, texture)
    GL.glPixelStorei(GL.GL_UNPACK_ALIGNMENT, 1)
    kind = (GL.GL_LUMINANCE, GL.GL_UNSIGNED_BYTE)
    GL.glTexSubImage2D(GL.GL_TEXTURE_2D, 0, *at.tolist(), width, height, *kind, bright)


def _touched(corners: np.ndarray, soft: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return minimum and maximum x, y (2, 2) of outlines with soft edges and a margin, clipped to the mask."""
    if not len(corners):
        return _NOWHERE
    low = np.floor(corners.min(axis=(0, 1))).astype(int) - soft - 2
    high = np.ceil(corners.max(axis=(0, 1))).astype(int) + soft + 3
    return np.stack([np.clip(low, 0, pixels), np.clip(high, 0, pixels)])


def _union(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the smallest area (minimum and maximum x, y) that contains both; empty areas are ignored."""
    if (a[1] <= a[0]).any():
        return b
    if (b[1] <= b[0]).any():
        return a
    return np.stack([np.minimum(a[0], b[0]), np.maximum(a[1], b[1])])


def _filled(corners: np.ndarray, soft: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return a mask (height, width) uint8: 255 within the outlines, (n, k, 2) pixels, with soft edges."""
    mask = np.zeros(pixels[::-1], np.uint8)
    polygons: np.ndarray = np.round(corners * (1 << _SUBPIXEL_BITS)).astype(np.int32)
    for polygon in polygons:
        cv2.fillConvexPoly(mask, polygon, 255, cv2.LINE_8, _SUBPIXEL_BITS)
    return cv2.blur(mask, soft.tolist())


def _outlines(axes: np.ndarray, sizes: np.ndarray, is_box: np.ndarray, is_rod: np.ndarray) -> np.ndarray:
    """Return corners (n, k, 2) of convex shadows, relative to their centres: the farthest point in k directions.

    axes: (n, 2, 3) projected unit axes of each shape. sizes: MuJoCo's. is_box, is_rod: (n,); others are ellipsoids.
    """
    toward = np.swapaxes(axes, 1, 2) @ _DIRECTIONS  # (n, 3, k)
    size = sizes[:, :, None]
    farthest = np.sign(toward) * size
    # A rod's size is (radius, half length, 0). The round ends of a capsule are treated as flat.
    across, radius = toward[is_rod, :2], size[is_rod, :1]
    farthest[is_rod, :2] = across * (radius / (np.sqrt((across**2).sum(axis=1, keepdims=True)) + 1e-12))
    farthest[is_rod, 2:] = np.sign(toward[is_rod, 2:]) * size[is_rod, 1:2]
    ball = ~(is_box | is_rod)
    if ball.any():
        scaled = size[ball] * toward[ball]
        farthest[ball] = size[ball] * scaled / (np.linalg.norm(scaled, axis=1, keepdims=True) + 1e-12)
    corners: np.ndarray = np.swapaxes(axes @ farthest, 1, 2)
    return corners
