"""Sliders for the joints and the gripper of one arm, and its gains. They show where it goes, or where it is."""

import time

import numpy as np
import viser

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.viewer.moving.driver import Driver
from lerobot_robot_yam.viewer.serving.handles import kept, pressed, put

_STEP_RAD, _STEP_OPENING = 0.001, 0.01
_SHOWN = 0.002  # rad, or of the stroke: smaller changes are not shown
_TOUCHED_S = 0.3  # for so long after a hand has moved it a slider is left alone: its message is on its way
_GAIN_STEP = 0.1


class JointSliders:
    """A folder of the page's panel.

    Args:
        gui: of the server.
        driver: is asked for what is dragged.
        hardware: the arm.
    """

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
        async def _(event: viser.GuiEvent) -> None:  # on viser's own thread, so in order
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
        """Follow the arm."""
        arm, now = self._driver.arms.get(self._hardware.name), time.monotonic()
        if arm is None:
            return
        shown = np.clip(arm.shown, self._hardware.lower, self._hardware.upper)
        for slider, value, touched_s in zip(self._sliders, shown.tolist(), self._touched_s, strict=True):
            if now - touched_s > _TOUCHED_S and not abs(slider.value - value) <= _SHOWN:  # nor if that is no number
                put(slider, value=value)
