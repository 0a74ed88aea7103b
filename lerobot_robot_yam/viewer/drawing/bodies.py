"""Bodies of a MuJoCo model in the scene: each is a frame with its shapes as meshes, and the frame moves with it."""

from collections.abc import Collection

import mujoco
import numpy as np
import viser

from lerobot_robot_yam.arm.export.body_meshes import Colour, meshes

_UNCHANGED = 2e-4  # m, and parts of a quaternion: below what can be seen, above the noise of an arm that stands


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
