"""Arrows and rings at the tool of one arm in the scene: drag them, and the joints follow."""

from collections.abc import Callable

import mujoco
import numpy as np
import viser

from lerobot_robot_yam.arm.kinematics import YamKinematics
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.errors import ActionError
from lerobot_robot_yam.viewer.live.placement import Place
from lerobot_robot_yam.viewer.moving.driver import Driver

_SIZE_PX = 90.0  # of an arrow, however far away: one of the length of the tool is too thin for a mouse
_SHOWN = 5e-4  # m, and of the quaternion: smaller changes are not shown


class ToolHandle:
    """Of one arm that is driven.

    Args:
        scene: of the server.
        driver: is asked for what is dragged.
        hardware: the arm.
        place: where its base is drawn; None: nowhere yet.
    """

    def __init__(self, scene: viser.SceneApi, driver: Driver, hardware: ResolvedArm, place: Callable[[], Place | None]):
        self._driver, self._hardware, self._place = driver, hardware, place
        self._kinematics = YamKinematics(hardware.arm, hardware.gripper)
        self._dragging: int | None = None  # the browser that does
        root = f"/moving/{hardware.name}"
        self._base = scene.add_frame(root, show_axes=False, visible=False)
        self._handle = scene.add_transform_controls(f"{root}/tool", scale=_SIZE_PX, fixed=True, depth_test=False)
        self._handle.on_update(self._dragged)

    async def _dragged(self, event: viser.TransformControlsEvent) -> None:
        browser, name = event.client_id, self._hardware.name
        position, quat = np.array(event.target.position), np.array(event.target.wxyz)
        if event.phase != "update" or browser is None:
            self._dragging = browser if event.phase == "start" else None
            return
        self._driver.ask(browser, lambda: self._driver.drag(browser, name, pose_of(position, quat)))

    def update(self) -> None:
        """Follow the arm, while nobody drags."""
        arm, place = self._driver.arms.get(self._hardware.name), self._place()
        shown = arm is not None and place is not None
        if self._base.visible != shown:
            self._base.visible = shown
        if arm is None or place is None:
            return
        self._show(self._base, *place)
        if self._dragging is not None and self._dragging == self._driver.desk.holder:
            return
        pose, quat = self._kinematics.fk(arm.shown[: self._hardware.joints]), np.empty(4)
        mujoco.mju_mat2Quat(quat, pose[:3, :3].ravel())
        self._show(self._handle, pose[:3, 3], quat)

    @staticmethod
    def _show(node: viser.FrameHandle | viser.TransformControlsHandle, position: np.ndarray, quat: np.ndarray) -> None:
        apart = max(np.abs(node.position - position).max(), np.abs(node.wxyz - quat).max())
        if not apart <= _SHOWN:  # nor if a browser has sent what is no number
            node.position, node.wxyz = position, quat

    def close(self) -> None:
        """Take it out of the scene. Idempotent."""
        self._base.remove()


def pose_of(position_m: np.ndarray, wxyz: np.ndarray) -> np.ndarray:
    """(4, 4) from (3,) m and a quaternion (4,). Raises ActionError: not finite, or no direction."""
    norm = float(np.linalg.norm(wxyz))
    if position_m.shape != (3,) or wxyz.shape != (4,) or not np.isfinite([*position_m, norm]).all() or norm < 1e-6:
        raise ActionError(f"this is no pose of a tool: {position_m} m, {wxyz}; nothing moves")
    pose, turn = np.eye(4), np.empty(9)
    mujoco.mju_quat2Mat(turn, wxyz / norm)
    pose[:3, :3], pose[:3, 3] = turn.reshape(3, 3), position_m
    return pose
