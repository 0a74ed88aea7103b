"""Primitive geoms that draw a body and let it touch things; they never carry mass.

Contact rule: arm parts (contype 2, conaffinity 1) meet MuJoCo's default objects (contype 1, conaffinity 1: table,
props) but neither each other nor another arm, which saves most of the collision time of two arms. Where an arm does
lean on itself the profile says so (`self_contacts`), and those pairs are declared one by one.
"""

import mujoco
import numpy as np

from lerobot_robot_yam.arm.profile import Shape
from lerobot_robot_yam.errors import ConfigError

VISUAL_GROUP = 2
COLLISION_GROUP = 3
"""Group of the invisible collision shapes; visible shapes that collide stay in the visual group."""

COLOURS: dict[str, tuple[float, float, float, float]] = {
    "housing": (0.13, 0.13, 0.15, 1.0),
    "metal": (0.74, 0.76, 0.78, 1.0),
    "cap": (0.30, 0.31, 0.34, 1.0),
    "accent": (0.95, 0.47, 0.08, 1.0),
    "rubber": (0.20, 0.20, 0.21, 1.0),
    "soft": (0.90, 0.90, 0.86, 1.0),
}

_GEOM = mujoco.mjtGeom
_KINDS = {
    "cylinder": _GEOM.mjGEOM_CYLINDER,
    "capsule": _GEOM.mjGEOM_CAPSULE,
    "box": _GEOM.mjGEOM_BOX,
    "ellipsoid": _GEOM.mjGEOM_ELLIPSOID,
}
_GRIPPING = ("rubber", "soft")  # colours of finger pads: they hold what they pinch


def add_shape(body: mujoco.MjsBody, shape: Shape, *, collisions: bool, name: str) -> None:
    """Add `shape` to `body` as geom `name`; it touches things only with `collisions`.

    Raises ConfigError for an unknown kind or colour.
    """
    visible = shape.colour != "none"
    if not visible and not (collisions and shape.collides):
        return
    if shape.kind not in _KINDS or (visible and shape.colour not in COLOURS):
        raise ConfigError(
            f"body '{body.name}': unknown shape '{shape.kind}' or colour '{shape.colour}'; "
            f"kinds {sorted(_KINDS)}, colours {sorted(COLOURS)} or 'none'"
        )
    geom = body.add_geom(name=name, type=_KINDS[shape.kind], mass=0.0, density=0.0)
    if shape.kind in ("cylinder", "capsule"):
        geom.fromto = np.concatenate([shape.from_m, shape.to_m])
        geom.size = [shape.radius_m, 0.0, 0.0]
    else:
        geom.pos, geom.quat, geom.size = shape.center_m, shape.quat_wxyz, shape.size_m / 2
    geom.rgba = COLOURS[shape.colour] if visible else (0.5, 0.5, 0.5, 0.3)
    geom.group = VISUAL_GROUP if visible else COLLISION_GROUP
    geom.contype, geom.conaffinity = (2, 1) if collisions and shape.collides else (0, 0)
    if shape.colour in _GRIPPING:
        geom.condim = 4
        geom.friction = [1.5, 0.02, 0.0001]  # rubber on wood, our estimate; torsion for a flat pad
        geom.priority = 1
        # MuJoCo's soft default lets the gripper's heavy rotor sink 8 mm into a 50 g prop and squeeze it out.
        geom.solref, geom.solimp[:3] = [0.004, 1.0], [0.95, 0.99, 0.001]
