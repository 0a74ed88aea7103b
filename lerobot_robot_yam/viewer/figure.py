"""3-D drawings of MuJoCo bodies, of whole arms, and of an arm's workspace limits.

Each link is a frame that contains its meshes and is nested in its parent link's frame. So a rotating joint costs one
message to the browsers, and a joint at rest costs none.
"""

from collections.abc import Collection, Sequence

import mujoco
import numpy as np
import viser

from lerobot_robot_yam.arm.export.body_meshes import Colour, meshes
from lerobot_robot_yam.arm.export.primitives import box
from lerobot_robot_yam.arm.model import VISUAL_GROUP, base_quat, build_spec
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm

_UNCHANGED = 2e-4  # threshold for sending a change, m or quaternion component: invisible, but above a still arm's noise
_GHOST = (70, 130, 255), 0.3
_TOOL_AXES_M = 0.08
_KEEP_OUT, _FLOOR, _LIMIT_OPACITY = (230, 60, 40), (230, 150, 40), 0.25
_FLOOR_M = (1.4, 1.4, 0.001)

Place = tuple[np.ndarray, np.ndarray]
"""Position (3,), m, and orientation w x y z (4,)."""


def add_body(
    scene: viser.SceneApi,
    name: str,
    model: mujoco.MjModel,
    body: int,
    groups: Collection[int],
    ghost: tuple[Colour, float] | None = None,
) -> viser.FrameHandle:
    """Add the frame of a body with its shapes in `groups`. `ghost`: one colour and opacity for all shapes."""
    frame = scene.add_frame(name, show_axes=False)
    for index, (mesh, colour) in enumerate(meshes(model, body, groups)):
        shade, opacity = ghost or (colour, None)
        scene.add_mesh_simple(f"{name}/{index}", mesh.vertices, mesh.faces, color=shade, opacity=opacity)
    return frame


def put(thing: viser.SceneNodeHandle, position_m: np.ndarray, quat_wxyz: np.ndarray) -> None:
    """Move a scene node to (3,), m, and quaternion (4,) in its parent frame. Changes too small to see are not sent."""
    if np.abs(position_m - thing.position).max() > _UNCHANGED:
        thing.position = position_m
    if np.abs(quat_wxyz - thing.wxyz).max() > _UNCHANGED:
        thing.wxyz = quat_wxyz


def on(carrier: Place, place: Place) -> Place:
    """Return the place in the world of what stands at `place` in the carrier's frame."""
    position, quat = np.empty(3), np.empty(4)
    mujoco.mju_rotVecQuat(position, place[0], carrier[1])
    mujoco.mju_mulQuat(quat, carrier[1], place[1])
    return carrier[0] + position, quat


class Figure:
    """Drawing of one arm or of its ghost.

    Args:
        scene: the server's scene.
        root: name of the frame at the arm's base.
        hardware: the arm.
        ghost: whether to draw the arm in one pale colour, without a tool frame.
    """

    def __init__(self, scene: viser.SceneApi, root: str, hardware: ResolvedArm, ghost: bool = False):
        self._model = model = build_spec(hardware.arm, hardware.gripper).compile()
        self._data = mujoco.MjData(model)
        self._joints = hardware.joints
        self._travel = hardware.gripper.finger_range_m
        self._base = scene.add_frame(root, show_axes=False)
        self._links: list[tuple[int, viser.FrameHandle]] = []
        names = [root]
        for body in range(1, model.nbody):
            name = f"{names[model.body_parentid[body]]}/{model.body(body).name}"
            names.append(name)
            link = add_body(scene, name, model, body, (VISUAL_GROUP,), _GHOST if ghost else None)
            self._links.append((body, link))
        if not ghost:
            site = model.site("tcp_site")
            scene.add_frame(
                f"{names[int(site.bodyid[0])]}/tcp",
                axes_length=_TOOL_AXES_M,
                axes_radius=_TOOL_AXES_M / 25,
                position=site.pos,
                wxyz=site.quat,
            )
        self.pose(np.zeros(self._joints))

    def stand(self, position_m: Sequence[float] | np.ndarray, quat_wxyz: Sequence[float] | np.ndarray) -> None:
        """Move the arm's base to a position (3,), m, and quaternion (4,)."""
        put(self._base, np.asarray(position_m, float), np.asarray(quat_wxyz, float))

    def pose(self, q: np.ndarray, gripper: float | None = None) -> None:
        """Show joint angles q (joints,), rad, and the gripper opening, 0 closed … 1 open."""
        data = self._data
        data.qpos[: self._joints] = np.nan_to_num(q)
        if self._travel is not None:
            closed, opened = self._travel
            data.qpos[self._joints :] = closed + np.clip(np.nan_to_num(gripper or 0.0), 0.0, 1.0) * (opened - closed)
        mujoco.mj_kinematics(self._model, data)
        position, quat, back = np.empty(3), np.empty(4), np.empty(4)
        for body, link in self._links:
            carrier = self._model.body_parentid[body]
            mujoco.mju_negQuat(back, data.xquat[carrier])
            mujoco.mju_rotVecQuat(position, data.xpos[body] - data.xpos[carrier], back)
            mujoco.mju_mulQuat(quat, back, data.xquat[body])
            put(link, position, quat)

    @property
    def visible(self) -> bool:
        """Whether the figure is shown."""
        return bool(self._base.visible)

    @visible.setter
    def visible(self, shown: bool) -> None:
        if self._base.visible != shown:
            self._base.visible = shown

    def remove(self) -> None:
        """Remove the figure and all nodes below its base from the scene."""
        self._base.remove()


def add_workspace(scene: viser.SceneApi, root: str, hardware: ResolvedArm) -> None:
    """Draw the floor and keep-out boxes of an arm's workspace, relative to the arm's base frame."""
    workspace = hardware.config.workspace
    base = np.array(workspace.base_position_m, float)
    turned_back = np.empty(4)
    mujoco.mju_negQuat(turned_back, base_quat(workspace.base_yaw_rad, hardware.tilt_rad))
    rows = [(each.name, each.center_m, each.size_m, each.yaw_rad, _KEEP_OUT) for each in workspace.keep_out]
    if workspace.floor_z_m is not None:
        rows.append(("floor", [base[0], base[1], workspace.floor_z_m], list(_FLOOR_M), 0.0, _FLOOR))
    for index, (name, center_m, size_m, yaw_rad, colour) in enumerate(rows):
        position, quat = np.empty(3), np.empty(4)
        mujoco.mju_rotVecQuat(position, np.array(center_m, float) - base, turned_back)
        mujoco.mju_mulQuat(quat, turned_back, base_quat(yaw_rad))
        mesh = box(size_m)
        scene.add_mesh_simple(
            f"{root}/workspace/{index} {name.replace('/', ' ')}",
            mesh.vertices,
            mesh.faces,
            color=colour,
            opacity=_LIMIT_OPACITY,
            position=position,
            wxyz=quat,
            cast_shadow=False,
        )
