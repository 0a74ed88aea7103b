"""Bodies of a MuJoCo model in the scene: each is a frame with its shapes as meshes, and the frame moves with it."""

from collections.abc import Collection

import mujoco
import numpy as np
import viser

from lerobot_robot_yam.viewer.drawing.primitives import Mesh, ball, box, capsule, cylinder, joined

_UNCHANGED = 2e-4  # m, and parts of a quaternion: below what can be seen, above the noise of an arm that stands

Colour = tuple[int, int, int]


def add_body(
    scene: viser.SceneApi,
    name: str,
    model: mujoco.MjModel,
    body: int,
    groups: Collection[int],
    ghost: tuple[Colour, float] | None = None,
) -> viser.FrameHandle:
    """The frame of a body, with its shapes of these groups. ghost: colour and opacity, instead of its own colours."""
    frame = scene.add_frame(name, show_axes=False)
    for index, (mesh, colour) in enumerate(meshes(model, body, groups)):
        shade, opacity = ghost or (colour, None)
        scene.add_mesh_simple(f"{name}/{index}", mesh.vertices, mesh.faces, color=shade, opacity=opacity)
    return frame


def put(thing: viser.SceneNodeHandle, position_m: np.ndarray, quat_wxyz: np.ndarray) -> None:
    """Put a thing there, (3,) and (4,), in the frame above it, unless it is there: each change is a message."""
    if np.abs(position_m - thing.position).max() > _UNCHANGED:
        thing.position = position_m
    if np.abs(quat_wxyz - thing.wxyz).max() > _UNCHANGED:
        thing.wxyz = quat_wxyz


def meshes(model: mujoco.MjModel, body: int, groups: Collection[int]) -> list[tuple[Mesh, Colour]]:
    """The shapes of a body that are in these groups, one mesh per colour, in the body's frame."""
    by_colour: dict[Colour, list[Mesh]] = {}
    for geom in range(model.ngeom):
        shown = model.geom_bodyid[geom] == body and model.geom_group[geom] in groups
        if shown and model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_PLANE:
            red, green, blue = (round(255 * float(share)) for share in model.geom_rgba[geom][:3])
            by_colour.setdefault((red, green, blue), []).append(_mesh(model, geom))
    return [(joined(parts), colour) for colour, parts in by_colour.items()]


def _mesh(model: mujoco.MjModel, geom: int) -> Mesh:
    """One shape in the frame of its body."""
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
