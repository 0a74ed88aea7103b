"""The part of the panel for connecting, control, float, hold, land, and what keeps the arms from moving."""

import html
from pathlib import Path

import viser

from lerobot_robot_yam.viewer.moving.control_desk import Stage
from lerobot_robot_yam.viewer.moving.driver import Driver
from lerobot_robot_yam.viewer.serving.handles import pressed

_HAZARD = (
    "**HAZARD: this energises {arms}.** Each arm holds where it is. Whoever takes control moves it from a browser. "
    "Keep clear of its way, and the emergency stop within reach."
)
_SEEKS = "The gripper of {arms} closes and opens fully to find its stops."


class ControlPanel:
    """Buttons and the line above them.

    Args:
        server: viser's.
        driver: is asked for what is pressed.
    """

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
        """Show how far we are."""
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
        heartbeat.begin_question(browser)  # sent first, so answered before a person can confirm
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
        """What will happen, for the person who has to confirm it."""
        plan = self._driver.plan
        names = [f"{config.name} ({config.channel})" for config in plan.configs]
        lines = [_HAZARD.format(arms=" and ".join(names))]
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
