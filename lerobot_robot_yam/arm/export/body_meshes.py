"""Meshes of the bodies in a MuJoCo model, for yam-view and Waldo Commander, and STL encoding."""

from collections.abc import Collection

import mujoco
import numpy as np

from lerobot_robot_yam.arm.export.primitives import Mesh, ball, box, capsule, cylinder, joined

Colour = tuple[int, int, int]
"""Red, green and blue, 0 … 255."""

_STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def meshes(model: mujoco.MjModel, body: int, groups: Collection[int]) -> list[tuple[Mesh, Colour]]:
    """Create one mesh per colour from a body's shapes in these groups, in the body's frame, m."""
    by_colour: dict[Colour, list[Mesh]] = {}
    for geom in range(model.ngeom):
        shown = model.geom_bodyid[geom] == body and model.geom_group[geom] in groups
        if shown and model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_PLANE:
            red, green, blue = (round(255 * float(share)) for share in model.geom_rgba[geom][:3])
            by_colour.setdefault((red, green, blue), []).append(_mesh(model, geom))
    return [(joined(parts), colour) for colour, parts in by_colour.items()]


def _mesh(model: mujoco.MjModel, geom: int) -> Mesh:
    """Create the mesh of one shape, in the frame of its body."""
    kind, size = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        mesh = box(2.0 * size)
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        mesh = cylinder(size[0], 2.0 * size[1])
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        mesh = capsule(size[0], 2.0 * size[1])
    elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        mesh = ball().scaled(np.full(3, size[0]))
    else:
        mesh = ball().scaled(size)
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
    return mesh.moved(turn.reshape(3, 3), model.geom_pos[geom])


def stl(mesh: Mesh) -> bytes:
    """Encode a mesh as a binary STL file with lengths in m."""
    corners = mesh.vertices[mesh.faces]
    rows = np.zeros(len(corners), _STL)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    rows["normal"] = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    rows["corners"] = corners
    return bytes(80) + len(rows).to_bytes(4, "little") + rows.tobytes()
