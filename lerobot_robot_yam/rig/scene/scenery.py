"""What only pleases the eye: sky, floor and light. Nothing here touches an arm or a prop on the table."""

import mujoco

_FLOOR_Z_M = -0.74  # the table's top is z = 0


def add_scenery(spec: mujoco.MjSpec) -> None:
    """Add sky, floor and light to a world. The floor stops what falls off the table."""
    head = spec.visual.headlight
    head.ambient, head.diffuse, head.specular = [0.38] * 3, [0.22] * 3, [0.05] * 3
    spec.visual.map.znear = 0.01
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.80, 0.87, 0.94],
        rgb2=[0.42, 0.53, 0.66],
        width=32,
        height=192,
    )
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        pos=[0.0, 0.0, _FLOOR_Z_M],
        size=[4.0, 4.0, 0.1],
        rgba=[0.50, 0.53, 0.56, 1.0],  # no texture: software OpenGL would take 40 % longer for a frame
    )
    for position, direction, level in (
        ([0.8, 0.8, 2.0], [-0.35, -0.4, -1.0], 0.45),
        ([-0.6, -1.0, 2.2], [0.3, 0.4, -1.0], 0.22),
    ):
        spec.worldbody.add_light(
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            pos=position,
            dir=direction,
            diffuse=[level, 0.97 * level, 0.92 * level],
            specular=[0.15] * 3,
            ambient=[0.0] * 3,
            castshadow=False,
        )
