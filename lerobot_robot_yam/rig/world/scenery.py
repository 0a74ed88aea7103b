"""What is seen besides arms and things: sky, floor and lights; and which surfaces show grain and shadows."""

from collections.abc import Sequence

import mujoco

from lerobot_robot_yam.rig.scene.props import Thing

TABLE, FLAT = "table top", "flat thing"  # materials begin so; the renderer draws their textures, see `render.shade`
_FLAT_M = 0.002  # thinner things show shadows as the table does
_FLOOR_Z_M = -0.74  # the table's top is z = 0


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


def add_shaded_surfaces(spec: mujoco.MjSpec, furniture: Sequence[Thing]) -> None:
    """Give the table, and flat things of the furniture that lie still, materials whose textures are drawn anew.

    The table is the largest fixed box whose top is at z = 0.
    """
    still = [thing for thing in furniture if thing.fixed and not thing.carrier]
    boxes = [(thing.name, thing.center_m[2], thing.size_m) for thing in still if thing.size_m is not None]
    areas = {name: float(x * y) for name, middle_z, (x, y, z) in boxes if abs(middle_z + z / 2) < 1e-6}
    if not areas:
        return
    _mark(spec.geom(max(areas, key=lambda name: areas[name])), spec, TABLE)
    for thing in still:
        for geom, part in zip(spec.body(thing.name).geoms, thing.all_parts, strict=True):
            if part.shape == "box" and part.size_m[2] < _FLAT_M:
                _mark(geom, spec, f"{FLAT} {geom.name}")


def _mark(geom: mujoco.MjsGeom, spec: mujoco.MjSpec, name: str) -> None:
    texture = spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, width=8, height=8)  # a stand-in
    texture.data = bytes([255]) * (8 * 8 * 3)
    spec.add_material(name=name).textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    geom.material = name
