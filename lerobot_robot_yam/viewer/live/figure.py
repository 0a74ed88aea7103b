"""One arm in the scene: its profiles' shapes, posed by its joints."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
import trimesh
import viser

from lerobot_robot_yam.arm.model import VISUAL_GROUP, build_spec
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm

_SECTIONS = 24  # of a circle
_GHOST = (70, 130, 255), 0.3
_TOOL_AXES_M = 0.08


class Figure:
    """A drawing of one arm, or the ghost of one, below a frame of the scene.

    Args:
        scene: of the server.
        root: name of the frame of its base.
        hardware: the arm.
        ghost: in one pale colour, without a tool frame.
    """

    def __init__(self, scene: viser.SceneApi, root: str, hardware: ResolvedArm, ghost: bool = False):
        self._model = model = build_spec(hardware.arm, hardware.gripper).compile()
        self._data = mujoco.MjData(model)
        self._joints = hardware.joints
        self._travel = hardware.gripper.finger_range_m
        self._base = scene.add_frame(root, show_axes=False)
        self._links: list[tuple[int, viser.FrameHandle]] = []
        for body in range(1, model.nbody):
            meshes = _meshes(model, body)
            if not meshes:
                continue
            name = f"{root}/{model.body(body).name}"
            self._links.append((body, scene.add_frame(name, show_axes=False)))
            for index, (mesh, colour) in enumerate(meshes):
                shade, opacity = _GHOST if ghost else (colour, None)
                scene.add_mesh_simple(f"{name}/{index}", mesh.vertices, mesh.faces, color=shade, opacity=opacity)
        self._tool = None
        if not ghost:
            self._tool = scene.add_frame(f"{root}/tcp", axes_length=_TOOL_AXES_M, axes_radius=_TOOL_AXES_M / 25)
        self.pose(np.zeros(self._joints))

    def stand(self, position_m: Sequence[float] | np.ndarray, quat_wxyz: Sequence[float] | np.ndarray) -> None:
        """Put its base there."""
        self._base.position, self._base.wxyz = np.asarray(position_m, float), np.asarray(quat_wxyz, float)

    def pose(self, q: np.ndarray, gripper: float | None = None) -> None:
        """Show it with joints q, (joints,) rad, and the gripper 0 closed … 1 open."""
        data = self._data
        data.qpos[: self._joints] = np.nan_to_num(q)
        if self._travel is not None:
            closed, opened = self._travel
            data.qpos[self._joints :] = closed + np.clip(np.nan_to_num(gripper or 0.0), 0.0, 1.0) * (opened - closed)
        mujoco.mj_kinematics(self._model, data)
        for body, link in self._links:
            link.position, link.wxyz = data.xpos[body], data.xquat[body]
        if self._tool is not None:
            self._tool.position, self._tool.wxyz = self.tool

    @property
    def tool(self) -> tuple[np.ndarray, np.ndarray]:
        """Position (3,) m and w x y z (4,) of tcp_site in the frame of the base, as posed last."""
        site, quat = self._data.site("tcp_site"), np.empty(4)
        mujoco.mju_mat2Quat(quat, site.xmat)
        return site.xpos.copy(), quat

    @property
    def visible(self) -> bool:
        """Whether it is shown."""
        return bool(self._base.visible)

    @visible.setter
    def visible(self, shown: bool) -> None:
        if self._base.visible != shown:
            self._base.visible = shown

    def remove(self) -> None:
        """Take it out of the scene, with everything below its base."""
        self._base.remove()


def _meshes(model: mujoco.MjModel, body: int) -> list[tuple[Any, tuple[int, int, int]]]:
    """The shapes of a body, one mesh per colour, in its frame."""
    by_colour: dict[tuple[int, int, int], list[Any]] = {}
    for geom in range(model.ngeom):
        if model.geom_bodyid[geom] == body and model.geom_group[geom] == VISUAL_GROUP:
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
