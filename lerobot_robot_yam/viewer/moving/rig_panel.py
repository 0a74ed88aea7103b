"""The part of the panel that only a virtual rig has: things are put elsewhere, and faults are set."""

from collections.abc import Callable, Sequence
from typing import Any

import viser

from lerobot_robot_yam.arm.validation import finite_vector
from lerobot_robot_yam.errors import ActionError
from lerobot_robot_yam.rig.simulation.rig_operations import RigOperations
from lerobot_robot_yam.viewer.moving.driver import Driver
from lerobot_robot_yam.viewer.serving.handles import pressed, put

_CHANNEL = "the whole channel"
_FAULTS: dict[str, tuple[str, Any, bool]] = {  # by label: kind, value, of a motor (else of the channel)
    "silent": ("silent", True, True),
    "stuck": ("stuck", True, True),
    "without power": ("power", False, True),
    "hot: 95 °C": ("temperatures_c", [95.0, 95.0], True),
    "half of its answers lost": ("loss_rate", 0.5, True),
    "over-current (0xA)": ("nibble", 0xA, True),
    "link down": ("link_down", True, False),
    "cable out": ("cable_out", True, False),
    "load of 1 kg": ("payload_kg", 1.0, False),
}


class RigPanel:
    """A folder. The driver's thread uses the rig.

    Args:
        gui: of the server.
        driver: is asked for what is pressed.
        rig: the virtual rig.
        channels: of the arms that are driven.
    """

    def __init__(self, gui: viser.GuiApi, driver: Driver, rig: RigOperations, channels: Sequence[str]):
        self._driver, self._rig = driver, rig
        props = [prop["name"] for prop in rig.scene()["props"]]
        motors = [motor for channel in channels for motor in rig.state()["arms"][channel]["motors"]]
        with gui.add_folder("virtual rig", expand_by_default=False):
            if props:
                self._prop = gui.add_dropdown("thing", props)
                self._where = gui.add_vector3("position, m", tuple(rig.state()["props"][props[0]]["pos"]), step=0.01)
                self._press(gui, "put it there", self._place)
                self._press(gui, "where is it?", self._look)
            self._channel = gui.add_dropdown("channel", list(channels))
            self._motor = gui.add_dropdown("motor", [_CHANNEL, *dict.fromkeys(motors)])
            self._fault = gui.add_dropdown("fault", list(_FAULTS))
            self._press(gui, "set the fault", self._set)
            self._press(gui, "clear its faults", lambda: rig.clear_faults(self._channel.value))

    def _press(self, gui: viser.GuiApi, label: str, work: Callable[[], None]) -> None:
        driver = self._driver

        def asked(browser: int) -> None:
            def unless_another_controls() -> None:
                driver.desk.check_unheld(browser)
                work()

            driver.ask_freely(browser, unless_another_controls)

        pressed(gui.add_button(label), asked)

    def _place(self) -> None:
        place = finite_vector(self._prop.value, "position", self._where.value, 3)
        self._rig.place(self._prop.value, place.tolist())

    def _look(self) -> None:
        put(self._where, value=tuple(self._rig.state()["props"][self._prop.value]["pos"]))

    def _set(self) -> None:
        kind, value, of_motor = _FAULTS[self._fault.value]
        motor = None if self._motor.value == _CHANNEL else self._motor.value
        if motor is not None and not of_motor:
            raise ActionError(f"{self._fault.value} is a fault of {_CHANNEL}: choose that")
        self._rig.fault(self._channel.value, motor, kind, value)
