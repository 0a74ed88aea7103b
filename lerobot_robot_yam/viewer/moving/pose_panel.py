"""The part of the panel for saved poses."""

import numpy as np
import viser

from lerobot_robot_yam.errors import LifeCycleError
from lerobot_robot_yam.viewer.moving.driver import Driver
from lerobot_robot_yam.viewer.moving.saved_poses import SavedPoses
from lerobot_robot_yam.viewer.serving.handles import pressed, put

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
            self._chosen = gui.add_dropdown("pose", poses.names or [_NONE])
            pressed(gui.add_button("go to it"), lambda b: driver.ask(b, self._go))
            self._name = gui.add_text("name", "")
            pressed(gui.add_button("save the present pose"), lambda b: driver.ask(b, self._save))
            pressed(gui.add_button("forget it"), lambda b: driver.ask(b, self._forget))

    def _go(self) -> None:
        self._driver.glide(self._poses[self._chosen.value])

    def _save(self) -> None:
        arms = self._driver.arms
        if not arms:
            raise LifeCycleError("the arms are not connected; nothing was saved")
        present = {
            name: np.clip(arm.client.observe().positions, arm.hardware.lower, arm.hardware.upper)
            for name, arm in arms.items()
        }
        name = str(self._name.value)
        self._poses.save(name, present)
        self._offer(name.strip())
        self._driver.say(None, f"saved in {self._poses.path}")

    def _forget(self) -> None:
        self._poses.forget(self._chosen.value)
        self._offer()

    def _offer(self, chosen: str | None = None) -> None:
        names = self._poses.names or [_NONE]
        self._chosen.options = names
        put(self._chosen, value=names[0] if chosen is None else chosen)
