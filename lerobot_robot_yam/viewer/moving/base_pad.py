"""Motion of a mobile base by buttons that a person holds down: each message of a held button is one short-lived target.

The control loop brakes a base whose newest target is older than `command_timeout_s`. A target counts from the earliest
time at which the browser can have given it, so a button let go, or a page or network that hangs, stops the base.
"""

import math
import time
from collections.abc import Callable
from functools import partial

import numpy as np
import viser

from lerobot_robot_yam.errors import LifeCycleError
from lerobot_robot_yam.mobile.resolved_base import ResolvedBase
from lerobot_robot_yam.session.base_client import BaseClient
from lerobot_robot_yam.state.base_records import BaseRequest
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.system.clock import Clock
from lerobot_robot_yam.viewer.moving.driver import Driver
from lerobot_robot_yam.viewer.serving.handles import pressed

_M_S, _RAD_S, _RAIL_M_S = 0.2, 0.4, 0.1  # velocities of the buttons: slow enough to be watched on a page
_HELD_HZ = 20.0  # rate of a held button's messages
_LET_GO_S = 0.4  # pause after an emergency stop in which no button may be held, s
_TWISTS = {
    "forward": (_M_S, 0.0, 0.0),
    "back": (-_M_S, 0.0, 0.0),
    "left": (0.0, _M_S, 0.0),
    "right": (0.0, -_M_S, 0.0),
    "turn left": (0.0, 0.0, _RAD_S),
    "turn right": (0.0, 0.0, -_RAD_S),
}
_RAIL = {"rail up": _RAIL_M_S, "rail down": -_RAIL_M_S}
_HOME = "home the rail (it goes all the way up and down)"


class BasePad:
    """Folder with buttons that drive a base, and its rail, while they are held down.

    Only the driver's thread sends targets, and only for the browser that controls.
    """

    def __init__(self, gui: viser.GuiApi, driver: Driver, base: ResolvedBase):
        self._driver, self._stopped_s = driver, -math.inf
        with gui.add_folder(base.name):
            gui.add_markdown("Hold a button down. Keep the way of the base clear.")
            for label, twist in _TWISTS.items():
                self._add(gui, label, partial(_drive, twist=np.array(twist)))
            if base.config.rail is None:
                return
            for label, velocity in _RAIL.items():
                self._add(gui, label, partial(_lift, velocity=velocity))
            pressed(gui.add_button(_HOME), lambda browser: driver.ask(browser, self._home))

    def _add(self, gui: viser.GuiApi, label: str, send: Callable[[BaseClient, float], object]) -> None:
        driver = self._driver

        async def held(event: viser.GuiEvent) -> None:  # async: viser then calls it in the order of arrival
            browser = event.client_id
            if browser is not None:
                given_s = driver.heartbeat.given_s(browser)
                driver.ask(browser, lambda: send(self._ready(), _on(driver.session.clock, given_s)))

        gui.add_button(label).on_hold(held, callback_hz=_HELD_HZ)

    def _ready(self) -> BaseClient:
        """Return the client. Raises LifeCycleError: emergency stop, or a button is held since; nothing moves."""
        (base,), now_s = self._driver.session.bases, time.monotonic()
        stopped = base.mode() is Mode.STOPPED
        if stopped or now_s - self._stopped_s < _LET_GO_S:
            self._stopped_s = now_s
            why = "the emergency stop is latched" if stopped else "let go of the button first, after an emergency stop"
            raise LifeCycleError(f"{base.config.name}: {why}; nothing moves")
        return base

    def _home(self) -> None:
        self._ready().request(BaseRequest.HOME_RAIL)


def _drive(base: BaseClient, given_s: float, twist: np.ndarray) -> None:
    base.write_velocity(twist, given_s=given_s)


def _lift(base: BaseClient, given_s: float, velocity: float) -> None:
    base.write_rail_velocity(velocity, given_s)


def _on(clock: Clock, given_s: float) -> float:
    """Convert a time of the monotonic clock, s, to the loop's clock: a rig in lock-step has its own."""
    return clock.now() - (time.monotonic() - given_s)
