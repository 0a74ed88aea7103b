"""Emergency stop on the page: one click latches the stop; releasing it requires a confirmation."""

import logging

import viser

from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.state.emergency_stop import EmergencyStop

logger = logging.getLogger(__name__)


class StopButton:
    """Buttons to latch and to release the emergency stop. The thread that receives the click latches the stop at once.

    Each click creates a new `EmergencyStop`: an object that failed to write its file stays latched forever.
    """

    def __init__(self, gui: viser.GuiApi):
        self._seen = EmergencyStop()
        self._failure = ""  # error of the last click; empty if there was none
        self._button = gui.add_button("EMERGENCY STOP", color="red", icon=viser.Icon.HAND_STOP)
        self._release = gui.add_button("release the emergency stop …", visible=False)
        self._button.on_click(lambda _: self._latch())
        self._release.on_click(self._ask)

    def update(self) -> list[str]:
        """Show whether the stop is latched; return lines for the banner."""
        latched = self._seen.latched
        if self._release.visible != latched:
            self._release.visible = latched
        if latched:
            self._failure = ""
            return [f"EMERGENCY STOP: {self._seen.reason()}"]
        return [f"THE EMERGENCY STOP FAILED: {self._failure}; switch the power off"] if self._failure else []

    def _latch(self) -> None:
        try:
            EmergencyStop().latch("yam-view", "yam-view")
        except (OSError, YamError) as error:
            self._failure = str(error)
            logger.critical("the emergency stop failed: %s; switch the power off", error)

    def _ask(self, event: viser.GuiEvent) -> None:
        client = event.client
        if client is None:
            return
        sources = self._seen.sources()
        if not sources:  # released in the meantime
            return
        with client.gui.add_modal("Release the emergency stop?") as question:
            latched = "\n".join(f"- `{name}`: {text.replace('`', ' ')}" for name, text in sources.items())
            client.gui.add_markdown(
                f"Latched by:\n{latched}\n\nArms move at once: those of running sessions go on to their targets, "
                "those of ended sessions land. Look at them first."
            )
            yes = client.gui.add_button("release", color="red")
            no = client.gui.add_button("keep it")

        def release(_: viser.GuiEvent) -> None:
            question.close()
            try:
                EmergencyStop().release(*sources)  # what was shown, not what has been latched since
            except (OSError, YamError) as error:
                client.add_notification("emergency stop", f"it stays latched: {error}")

        yes.on_click(release)
        no.on_click(lambda _: question.close())
