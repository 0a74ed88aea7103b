"""The limits of an arm's workspace in the scene: its floor, and the boxes that it keeps out of."""

import mujoco
import numpy as np
import viser

from lerobot_robot_yam.arm.model import base_quat
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.viewer.drawing.primitives import box

_BOX, _FLOOR = (230, 60, 40), (230, 150, 40)
_OPACITY = 0.25
_FLOOR_M = (1.4, 1.4, 0.001)


def add_workspace(scene: viser.SceneApi, root: str, hardware: ResolvedArm) -> None:
    """Draw them below the frame of the arm's base, wherever that stands."""
    workspace = hardware.config.workspace
    base = np.array(workspace.base_position_m, float)
    turned_back = np.empty(4)
    mujoco.mju_negQuat(turned_back, base_quat(workspace.base_yaw_rad, hardware.tilt_rad))
    rows = [(box.name, box.center_m, box.size_m, box.yaw_rad, _BOX) for box in workspace.keep_out]
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
            opacity=_OPACITY,
            position=position,
            wxyz=quat,
            cast_shadow=False,
        )
