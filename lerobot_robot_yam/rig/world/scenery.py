"""What is seen besides arms and things: sky, floor, lights, and the table's top with its grain and its shadows.

MuJoCo's shadow maps take three to four times as long as the picture itself on software OpenGL. Here shadows are a dark
sheet just above the table, the geom `SHADE`, whose texture the renderer replaces for each pose of the world.
"""

from collections.abc import Sequence

import mujoco
import numpy as np

from lerobot_robot_yam.rig.scene.props import Thing

SHADE = "shade"  # geom, material and texture of the shadows
_SHADE_ABOVE_M = 0.0015  # above pads, which are 1 mm thick
_FLOOR_Z_M = -0.74  # the table's top is z = 0
_GRAIN_PIXELS = (1024, 512)
_PLANK_M = 0.175
_TONE, _GRAIN = 9.0, 11.0  # grey levels (sigma): from plank to plank, and within one


def add_scenery(spec: mujoco.MjSpec) -> None:
    """Add sky, floor and lights. The floor stops things that fall off the table; the rest touches nothing."""
    head = spec.visual.headlight
    head.ambient, head.diffuse, head.specular = [0.38] * 3, [0.22] * 3, [0.05] * 3
    spec.visual.map.znear = 0.01
    sky = spec.add_texture(name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, width=32, height=192)
    sky.builtin, sky.rgb1, sky.rgb2 = mujoco.mjtBuiltin.mjBUILTIN_GRADIENT, [0.80, 0.87, 0.94], [0.42, 0.53, 0.66]
    floor = spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[4.0, 4.0, 0.1])
    floor.pos = [0.0, 0.0, _FLOOR_Z_M]
    floor.rgba = [0.50, 0.53, 0.56, 1.0]
    for position, direction, level in (
        ([0.8, 0.8, 2.0], [-0.35, -0.4, -1.0], 0.45),
        ([-0.6, -1.0, 2.2], [0.3, 0.4, -1.0], 0.22),
    ):
        light = spec.worldbody.add_light(type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, pos=position, dir=direction)
        light.diffuse, light.specular = [level, 0.97 * level, 0.92 * level], [0.15] * 3
        light.ambient, light.castshadow = [0.0] * 3, False


def add_table_top(spec: mujoco.MjSpec, furniture: Sequence[Thing]) -> None:
    """Give the table a grain, and a sheet for shadows. The table is the largest fixed box whose top is at z = 0."""
    boxes = [thing for thing in furniture if thing.fixed and thing.size_m is not None and not thing.carrier]
    tables = [(float(np.prod(t.size_m[:2])), t) for t in boxes if abs(t.center_m[2] + t.size_m[2] / 2) < 1e-6]
    if not tables:
        return
    table = max(tables, key=lambda row: row[0])[1]
    _add_texture(spec, "grain", _grain(float(table.size_m[1])))
    spec.geom(table.name).material = "grain"
    _add_texture(spec, SHADE, np.zeros((8, 8, 3), np.uint8))  # a stand-in
    x, y, z = table.size_m / 2
    sheet = spec.body(table.name).add_geom(name=SHADE, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[x, y, 1.0])
    sheet.pos, sheet.material = [0.0, 0.0, z + _SHADE_ABOVE_M], SHADE
    sheet.contype = sheet.conaffinity = 0
    sheet.rgba = [0.0, 0.0, 0.0, 0.99]  # MuJoCo blends what is below 0.999


def _add_texture(spec: mujoco.MjSpec, name: str, pixels: np.ndarray) -> None:
    """A texture of (height, width, channels) uint8, and a material of the same name that shows it once."""
    height, width, channels = pixels.shape
    texture = spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, width=width, height=height)
    texture.nchannel = channels
    texture.data = pixels.tobytes()
    spec.add_material(name=name).textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name


def _grain(width_m: float) -> np.ndarray:
    """(height, width, 3) uint8: planks of wood along x, by which the table's colour is multiplied."""
    width, height = _GRAIN_PIXELS
    random = np.random.default_rng(7)
    planks = max(1, round(width_m / _PLANK_M))
    plank = np.arange(height) * planks // height
    fine, coarse = random.normal(size=(height, width)), random.normal(size=(height, width))
    tone = _TONE * random.normal(size=planks)[plank][:, None]
    streaks = _along(fine, width // 6) + 0.8 * _along(_along(coarse, width // 3).T, 7).T
    level = 224.0 + tone + _GRAIN * streaks / streaks.std()
    seam = np.flatnonzero(np.diff(plank, prepend=0))
    level[seam] -= 38.0
    return np.repeat(np.clip(level, 0, 255).astype(np.uint8)[:, :, None], 3, axis=2)


def _along(noise: np.ndarray, length: int) -> np.ndarray:
    """Moving average of `length` along rows that go round, with standard deviation 1."""
    padded = np.concatenate([noise, noise[:, : length - 1]], axis=1)
    total = np.cumsum(np.pad(padded, ((0, 0), (1, 0))), axis=1)
    mean: np.ndarray = (total[:, length:] - total[:, :-length]) / length
    return mean / mean.std()
