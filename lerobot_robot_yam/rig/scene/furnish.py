"""Puts the things of a scene into a MuJoCo world: a body each, named after the thing, as is its joint."""

import math
from collections.abc import Sequence

import mujoco
import numpy as np

from lerobot_robot_yam.rig.scene.props import Part, Thing

_SHAPES = {"box": mujoco.mjtGeom.mjGEOM_BOX, "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER}
_JOINTS = {"slide": mujoco.mjtJoint.mjJNT_SLIDE, "hinge": mujoco.mjtJoint.mjJNT_HINGE}


def yaw_quat(yaw_rad: float) -> np.ndarray:
    """Quaternion (4,) w x y z of a turn about the vertical."""
    return np.array([math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2)])


def add_things(spec: mujoco.MjSpec, things: Sequence[Thing]) -> None:
    """Add things; those that stand on another one after it."""
    for thing in sorted(things, key=lambda thing: bool(thing.carrier)):
        parent = spec.body(thing.carrier) if thing.carrier else spec.worldbody
        body = parent.add_body(name=thing.name, pos=thing.center_m, quat=yaw_quat(thing.yaw_rad))
        if thing.joint is not None:
            _add_joint(body, thing)
        elif not thing.fixed:
            body.add_freejoint(name=thing.name)
        solid_m3 = sum(part.volume_m3 for part in thing.all_parts if part.solid)
        for i, part in enumerate(thing.all_parts):
            _add_part(body, thing, part, f"{thing.name}_{i}" if i else thing.name, solid_m3)
        if thing.carrier:
            # Between a body and its parent MuJoCo leaves contacts out anyway, but for a parent that is fixed.
            spec.add_exclude(bodyname1=thing.carrier, bodyname2=thing.name)


def _add_joint(body: mujoco.MjsBody, thing: Thing) -> None:
    row = thing.joint
    assert row is not None
    joint = body.add_joint(name=thing.name, type=_JOINTS[row.kind], axis=row.axis, pos=row.pivot_m)
    joint.range, joint.limited = row.range, mujoco.mjtLimited.mjLIMITED_TRUE
    joint.frictionloss, joint.damping = row.friction, [row.damping, 0.0, 0.0]


def _add_part(body: mujoco.MjsBody, thing: Thing, part: Part, name: str, solid_m3: float) -> None:
    x, _, z = part.size_m / 2
    size = part.size_m / 2 if part.shape == "box" else [x, z, 0.0]
    geom = body.add_geom(name=name, type=_SHAPES[part.shape], size=size, pos=part.center_m, quat=part.quat_wxyz)
    geom.rgba = thing.rgba if part.rgba is None else part.rgba
    geom.friction = [thing.friction, 0.01, 0.0001]
    geom.condim = 4
    geom.mass = thing.mass_kg * part.volume_m3 / solid_m3 if part.solid else 0.0
    if not part.solid:
        geom.contype = geom.conaffinity = 0
