"""Controls of one arm: sliders for joints, gripper and gains, and a 3-D handle (arrows and rings) at the tool."""

import time
from collections.abc import Callable

import mujoco
import numpy as np
import viser

from lerobot_robot_yam.arm.kinematics import YamKinematics
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.errors import ActionError
from lerobot_robot_yam.viewer.figure import Place
from lerobot_robot_yam.viewer.moving.driver import Driver
from lerobot_robot_yam.viewer.serving.handles import kept, pressed, put

_STEP_RAD, _STEP_OPENING = 0.001, 0.01
_SHOWN_RAD = 0.002  # minimum difference for updating a slider, rad or fraction of the gripper's stroke
_TOUCHED_S = 0.3  # time after a person's last move in which a slider is not updated, s: more messages may be under way
_GAIN_STEP = 0.1
_SIZE_PX = 90.0  # size of the handle at any distance, pixels: arrows of the tool's length are too thin for a mouse
_SHOWN_M = 5e-4  # minimum difference for updating a tool handle, m or quaternion component


class JointSliders:
    """Folder of one arm with sliders that show the arm's goal, or its set-point if it has no goal."""

    def __init__(self, gui: viser.GuiApi, driver: Driver, hardware: ResolvedArm):
        self._driver, self._hardware = driver, hardware
        self._touched_s = [0.0] * hardware.n
        start = np.clip(np.append(hardware.rest_q, [0.0] * hardware.has_gripper), hardware.lower, hardware.upper)
        with gui.add_folder(hardware.name):
            self._sliders = [self._slider(gui, motor, float(start[motor])) for motor in range(hardware.n)]
            if hardware.joints:
                with gui.add_folder("gains", expand_by_default=False):
                    self._add_gains(gui)

    def _slider(self, gui: viser.GuiApi, motor: int, start: float) -> viser.GuiSliderHandle[float]:
        hw, name = self._hardware, self._hardware.name
        joint = motor < hw.joints
        slider = gui.add_slider(
            f"{hw.motors[motor].name}, rad" if joint else "gripper, 0 closed, 1 open",
            min=float(hw.lower[motor]),
            max=float(hw.upper[motor]),
            step=_STEP_RAD if joint else _STEP_OPENING,
            initial_value=start,
        )

        @slider.on_update
        async def _(event: viser.GuiEvent) -> None:  # async: viser then calls it on its own thread, in order
            value = event.target.value
            if event.client_id is not None:
                self._touched_s[motor] = time.monotonic()
                self._driver.ask(event.client_id, lambda: self._driver.move(name, motor, value))

        return slider

    def _add_gains(self, gui: viser.GuiApi) -> None:
        hw, name = self._hardware, self._hardware.name
        kp, kd = hw.kp[: hw.joints], hw.kd[: hw.joints]
        may_set = self._driver.desk.is_free_for
        rows = [
            [
                kept(gui.add_number(f"{what} {joint}", float(value), min=0.0, step=_GAIN_STEP), may_set)
                for joint, value in zip(hw.joint_names, values, strict=True)
            ]
            for what, values in (("kp", kp), ("kd", kd))
        ]

        def change(browser: int) -> None:
            given = [np.array([number.value for number in row]) for row in rows]
            self._driver.ask(browser, lambda: self._driver.change_gains(name, *given))

        def reset() -> None:
            self._driver.change_gains(name, kp, kd)
            for row, values in zip(rows, (kp, kd), strict=True):
                for number, value in zip(row, values.tolist(), strict=True):
                    put(number, value=value)

        pressed(gui.add_button("use these gains"), change)
        pressed(gui.add_button("reset gains"), lambda browser: self._driver.ask(browser, reset))

    def update(self) -> None:
        """Set the sliders to the arm's goal, or to its set-point if it has no goal."""
        arm, now = self._driver.arms.get(self._hardware.name), time.monotonic()
        if arm is None:
            return
        shown = np.clip(arm.shown, self._hardware.lower, self._hardware.upper)
        for slider, value, touched_s in zip(self._sliders, shown.tolist(), self._touched_s, strict=True):
            if now - touched_s > _TOUCHED_S and not abs(slider.value - value) <= _SHOWN_RAD:  # replaces NaN, too
                put(slider, value=value)


class ToolHandle:
    """3-D handle (arrows and rings) at the tool of a driven arm. A person drags the handle, and the joints follow.

    `place`: function that returns the drawn pose of the arm's base, or None.
    """

    def __init__(self, scene: viser.SceneApi, driver: Driver, hardware: ResolvedArm, place: Callable[[], Place | None]):
        self._driver, self._hardware, self._place = driver, hardware, place
        self._kinematics = YamKinematics(hardware.arm, hardware.gripper)
        self._dragging: int | None = None  # browser that drags the handle
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
        """Move the handle to the arm's tool, unless a person drags the handle."""
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
        if not apart <= _SHOWN_M:  # true for NaN sent by a browser, so that NaN is replaced
            node.position, node.wxyz = position, quat


def pose_of(position_m: np.ndarray, wxyz: np.ndarray) -> np.ndarray:
    """Return the pose (4, 4) for a position (3,), m, and a quaternion (4,), which need not be normalised.

    Raises:
        ActionError: a shape is wrong, a value is not finite, or the quaternion is zero.
    """
    norm = float(np.linalg.norm(wxyz))
    if position_m.shape != (3,) or wxyz.shape != (4,) or not np.isfinite([*position_m, norm]).all() or norm < 1e-6:
        raise ActionError(f"this is no pose of a tool: {position_m} m, {wxyz}; nothing moves")
    pose, turn = np.eye(4), np.empty(9)
    mujoco.mju_quat2Mat(turn, wxyz / norm)
    pose[:3, :3], pose[:3, 3] = turn.reshape(3, 3), position_m
    return pose
