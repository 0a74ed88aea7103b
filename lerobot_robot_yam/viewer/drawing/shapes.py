"""Shapes of a MuJoCo model as meshes for the scene."""

from collections.abc import Collection
from typing import Any

import mujoco
import numpy as np
import trimesh

Colour = tuple[int, int, int]
_SECTIONS = 24  # of a circle


def meshes(model: mujoco.MjModel, body: int, groups: Collection[int]) -> list[tuple[Any, Colour]]:
    """The shapes of a body that are in these groups, one mesh per colour, in the body's frame."""
    by_colour: dict[Colour, list[Any]] = {}
    for geom in range(model.ngeom):
        shown = model.geom_bodyid[geom] == body and model.geom_group[geom] in groups
        if shown and model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_PLANE:
            red, green, blue = (round(255 * float(share)) for share in model.geom_rgba[geom][:3])
            by_colour.setdefault((red, green, blue), []).append(_mesh(model, geom))
    return [(trimesh.util.concatenate(parts), colour) for colour, parts in by_colour.items()]


def _mesh(model: mujoco.MjModel, geom: int) -> Any:
    """One shape in the frame of its body. trimesh's capsule begins at its lower centre; MuJoCo's is in the middle."""
    kind, size = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        mesh = trimesh.creation.box(2.0 * size)
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        mesh = trimesh.creation.cylinder(size[0], 2.0 * size[1], sections=_SECTIONS)
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        mesh = trimesh.creation.capsule(2.0 * size[1], size[0], count=[_SECTIONS, _SECTIONS])
        mesh.apply_translation(-mesh.bounds.mean(axis=0))
    else:
        mesh = trimesh.creation.icosphere(subdivisions=2)
        mesh.apply_scale(size)
    place, turn = np.eye(4), np.empty(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
    place[:3, :3], place[:3, 3] = turn.reshape(3, 3), model.geom_pos[geom]
    mesh.apply_transform(place)
    return mesh
