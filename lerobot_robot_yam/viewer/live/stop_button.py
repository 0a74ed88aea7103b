"""The emergency stop of the page: one click latches it, and it asks before it lets go."""

import viser

from lerobot_robot_yam.state.emergency_stop import EmergencyStop


class StopButton:
    """Two buttons at the top of the panel. The stop is latched in the thread that hears the click, without a wait.

    Args:
        gui: of the server.
    """

    def __init__(self, gui: viser.GuiApi):
        self._stop = EmergencyStop()
        self._button = gui.add_button("EMERGENCY STOP", color="red", icon=viser.Icon.HAND_STOP)
        self._release = gui.add_button("release the emergency stop …", visible=False)
        self._button.on_click(lambda _: self._stop.latch("yam-view"))
        self._release.on_click(self._ask)

    def update(self) -> list[str]:
        """Show what is so; returns lines for the banner."""
        latched = self._stop.latched
        if self._release.visible != latched:
            self._release.visible = latched
        return [f"EMERGENCY STOP: {self._stop.reason()}"] if latched else []

    def _ask(self, event: viser.GuiEvent) -> None:
        if event.client is None:
            return
        with event.client.gui.add_modal("Release the emergency stop?") as question:
            event.client.gui.add_markdown(
                "Arms move at once: those of running sessions go on to their targets, those of ended sessions land. "
                "Look at them first."
            )
            yes = event.client.gui.add_button("release", color="red")
            no = event.client.gui.add_button("keep it")

        def release(_: viser.GuiEvent) -> None:
            self._stop.release()
            question.close()

        yes.on_click(release)
        no.on_click(lambda _: question.close())
