"""The part of the panel for saved poses."""

from collections.abc import Callable
from typing import Any

import numpy as np
import viser

from lerobot_robot_yam.errors import LifeCycleError
from lerobot_robot_yam.viewer.moving.driver import Driver
from lerobot_robot_yam.viewer.moving.saved_poses import SavedPoses
from lerobot_robot_yam.viewer.serving.handles import kept, pressed, put

_NONE = "(no pose is saved)"


class PosePanel:
    """A folder: choose a pose and go there, save one, forget one.

    Args:
        gui: of the server.
        driver: is asked for what is pressed.
        poses: that are saved.
    """

    def __init__(self, gui: viser.GuiApi, driver: Driver, poses: SavedPoses):
        self._driver, self._poses = driver, poses
        with gui.add_folder("poses"):
            self._chosen = kept(gui.add_dropdown("pose", poses.names or [_NONE]), driver.desk.is_free_for)
            pressed(gui.add_button("go to it"), self._with(self._chosen, self._go))
            name = kept(gui.add_text("name", ""), driver.desk.is_free_for)
            pressed(gui.add_button("save the present pose"), self._with(name, self._save))
            pressed(gui.add_button("forget it"), self._with(self._chosen, self._forget))

    def _with(self, control: Any, work: Callable[[str], None]) -> Callable[[int], None]:
        """Asks the driver to do this with what a control shows at the press."""

        def asked(browser: int) -> None:
            shown = str(control.value)
            self._driver.ask(browser, lambda: work(shown))

        return asked

    def _go(self, name: str) -> None:
        self._driver.glide(self._poses[name])

    def _save(self, name: str) -> None:
        arms = self._driver.arms
        if not arms:
            raise LifeCycleError("the arms are not connected; nothing was saved")
        present = {
            name: np.clip(arm.client.observe().positions, arm.hardware.lower, arm.hardware.upper)
            for name, arm in arms.items()
        }
        self._poses.save(name, present)
        self._offer(name.strip())
        self._driver.say(None, f"saved in {self._poses.path}")

    def _forget(self, name: str) -> None:
        self._poses.forget(name)
        self._offer()

    def _offer(self, chosen: str | None = None) -> None:
        names = self._poses.names or [_NONE]
        self._chosen.options = names
        put(self._chosen, value=names[0] if chosen is None else chosen)
