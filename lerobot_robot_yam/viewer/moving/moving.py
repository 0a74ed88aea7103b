"""Part of the page that drives arms. It energises nothing until a person has confirmed on the page."""

import functools
import html
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import viser

from lerobot_robot_yam.arm.config import VIRTUAL
from lerobot_robot_yam.arm.validation import finite_vector
from lerobot_robot_yam.errors import ActionError
from lerobot_robot_yam.mobile.resolved_base import ResolvedBase
from lerobot_robot_yam.rig.control import RigControl
from lerobot_robot_yam.rig.lockstep.lockstep_rig import find_lockstep
from lerobot_robot_yam.rig.simulation.rig_operations import RigOperations
from lerobot_robot_yam.session.arm_session import Isolation
from lerobot_robot_yam.viewer.figure import Place
from lerobot_robot_yam.viewer.moving.arm_controls import JointSliders, ToolHandle
from lerobot_robot_yam.viewer.moving.base_pad import BasePad
from lerobot_robot_yam.viewer.moving.control_desk import Stage
from lerobot_robot_yam.viewer.moving.driver import Driver
from lerobot_robot_yam.viewer.moving.driving_plan import DrivingPlan
from lerobot_robot_yam.viewer.moving.saved_poses import PosePanel, SavedPoses
from lerobot_robot_yam.viewer.serving.handles import pressed, put

_HAZARD = (
    "**HAZARD: this energises {arms}.** Each arm holds where it is. Whoever takes control moves it from a browser. "
    "Keep clear of its way, and the emergency stop within reach."
)
_DRIVES = "The base stands with torque, and drives while its buttons are held: keep its way and what it carries clear."
_SEEKS = "The gripper of {arms} closes and opens fully to find its stops."
_CHANNEL = "the whole channel"
_FAULTS: dict[str, tuple[str, Any, bool]] = {  # label → kind, value, whether it is a motor's fault
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
_NOTICE_S = 8.0


class ControlPanel:
    """Buttons to connect, control, float, hold and land, below a text that shows why an arm is held back."""

    def __init__(self, server: viser.ViserServer, driver: Driver):
        self._driver, gui = driver, server.gui
        self._text = gui.add_html("")
        self._connect = gui.add_button("connect …", color="orange")
        self._connect.on_click(self._ask_to_connect)
        ask, free = driver.ask, driver.ask_freely
        self._take = pressed(gui.add_button("take control"), lambda b: free(b, lambda: driver.take(b)))
        self._others = [
            pressed(gui.add_button("give control"), lambda b: ask(b, lambda: driver.give(b))),
            pressed(gui.add_button("hold"), lambda b: ask(b, driver.hold)),
            pressed(gui.add_button("float"), lambda b: ask(b, driver.let_float)),
            pressed(gui.add_button("land"), lambda b: ask(b, driver.land)),
            pressed(gui.add_button("re-arm"), lambda b: ask(b, driver.rearm)),
        ]

    def update(self) -> None:
        """Show the stage, and the buttons available in that stage."""
        desk, driver = self._driver.desk, self._driver
        lines = [f"<b>{desk.stage.value.upper()}</b>"]
        if desk.holder is not None:
            lines.append(f"browser {desk.holder} controls the arms")
        if desk.asker is not None:
            lines.append(f"browser {desk.asker} asks for control")
        lines += [
            f"<b style='color:#c60'>{name}: held back: {html.escape(why)}</b>"
            for name, why in sorted(driver.held_back.items())
        ]
        content = f"<div style='padding:0 0.8em'>{'<br>'.join(lines)}</div>"
        if self._text.content != content:
            self._text.content = content
        watching = desk.stage is Stage.WATCHING
        for button, shown in ((self._connect, watching), *((other, not watching) for other in self._buttons)):
            if button.visible != shown:
                button.visible = shown

    @property
    def _buttons(self) -> list[viser.GuiButtonHandle]:
        return [self._take, *self._others]

    def _ask_to_connect(self, event: viser.GuiEvent) -> None:
        if event.client is None or event.client_id is None:
            return
        browser, gui, heartbeat = event.client_id, event.client.gui, self._driver.heartbeat
        heartbeat.begin_question(browser)  # first, so that a heartbeat reply precedes the confirmation
        with gui.add_modal("Energise the arms?") as question:
            gui.add_markdown(self.hazard())
            yes = pressed(gui.add_button("energise", color="red"), self._driver.ask_to_connect)
            no = gui.add_button("no")

        def close(_: int) -> None:
            question.close()
            heartbeat.end_question(browser)

        for button in (yes, no):
            pressed(button, close)

    def hazard(self) -> str:
        """Return the warning that a person must confirm."""
        plan = self._driver.plan
        names = [f"{config.name} ({config.channel})" for config in plan.parts]
        lines = [_HAZARD.format(arms=" and ".join(names)), *([] if plan.base is None else [_DRIVES])]
        seeks = [
            config.name
            for config in plan.configs
            if self._driver.session.hardware(config.name).has_gripper
            and config.gripper_search
            and config.gripper_stops_rad is None
            and not (config.calibration_path and Path(config.calibration_path).exists())
        ]
        if seeks:
            lines.append(_SEEKS.format(arms=" and ".join(seeks)))
        return "\n\n".join([*lines, *plan.notes])


class RigPanel:
    """Folder to move objects and to set faults of a virtual rig. Only the driver's thread uses the rig.

    `channels`: CAN channels of the driven arms.
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


class Moving:
    """Controls for a plan's arms.

    Args:
        server: viser's server.
        plan: plan with the configs of the arms.
        place: function that returns the drawn pose of an arm's base for a channel key, or None.
        isolation: see `ArmSession`.

    Attributes:
        driver: driver of the arms. The caller must start its thread.

    Raises:
        ConfigError: the arms cannot be used together, or the file of saved poses is invalid.
        RigError: the virtual rig cannot be started.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        plan: DrivingPlan,
        place: Callable[[str], Place | None],
        isolation: Isolation = "process",
    ):
        self._server = server
        self.driver = driver = Driver(plan, server, isolation)
        session, gui = driver.session, server.gui
        hardware = [session.hardware(config.name) for config in plan.configs]
        self._rig: RigOperations | None = None
        try:
            poses = SavedPoses(plan.poses, hardware)
            with gui.add_folder("move") as folder:
                self._control = ControlPanel(server, driver)
                self._sliders = [JointSliders(gui, driver, arm) for arm in hardware]
                if plan.base is not None:
                    BasePad(gui, driver, ResolvedBase(plan.base))
                if hardware:
                    PosePanel(gui, driver, poses)
                self._rig = _rig_of(driver)
                if self._rig is not None:
                    RigPanel(gui, driver, self._rig, [config.channel for config in plan.configs])
            self._tools = [
                ToolHandle(server.scene, driver, arm, functools.partial(place, session.key(arm.name)))
                for arm in hardware
                if arm.joints
            ]
        except BaseException:
            self.close()
            raise

        @server.on_client_connect
        def _(client: viser.ClientHandle) -> None:
            with folder:
                client.gui.add_markdown(f"This is browser {client.client_id}.", order=0.0)

        @server.on_client_disconnect
        async def _(client: viser.ClientHandle) -> None:
            driver.ask_to_leave(client.client_id)

    def update(self, now_s: float) -> None:
        """Update all controls, and show new notices."""
        self._control.update()
        for sliders in self._sliders:
            sliders.update()
        for tool in self._tools:
            tool.update()
        clients = self._server.get_clients()
        while self.driver.notices:
            notice = self.driver.notices.popleft()
            for browser, client in clients.items():
                if notice.browser in (None, browser):
                    client.add_notification("arms", notice.text, auto_close_seconds=_NOTICE_S)

    def close(self) -> None:
        """Land the arms. Idempotent."""
        self.driver.close()
        if isinstance(self._rig, RigControl):
            self._rig.close()


def _rig_of(driver: Driver) -> RigOperations | None:
    """Return the virtual rig of the arms, or None for real arms."""
    for config in driver.plan.configs:
        options = dict(driver.session.hardware(config.name).config.can_options)
        rig = options.pop("rig", None)
        if config.interface == VIRTUAL:
            return RigControl(rig, options.pop("scene", None), **options)
        if lockstep := find_lockstep(rig):
            return lockstep
    return None
