"""Controls to replay a recorded episode on the arms: request, confirm, watch, pause and end."""

import html
from collections.abc import Sequence
from typing import TYPE_CHECKING

import viser

from lerobot_robot_yam.face.datasets.check.flags import Flag
from lerobot_robot_yam.face.datasets.check.opened_dataset import RecordedEpisode
from lerobot_robot_yam.viewer.data.recorded_arms import RecordedArm, motion_of
from lerobot_robot_yam.viewer.serving.handles import pressed, put

if TYPE_CHECKING:  # the driver loads the inverse kinematics, not needed by a page without arms
    from lerobot_robot_yam.viewer.moving.driver import Driver

LEAST_SPEED, MOST_SPEED = 0.1, 2.0


class ReplayDesk:
    """Replay controls for the browser that controls the arms.

    Args:
        gui: the server's gui.
        driver: driver of the arms.
        prefixes: prefix of each arm's recorded values, in the driver's order: "", or "left_" and "right_".
        arms: arms of the data set.
        fps: frames per second of the data set.
    """

    def __init__(
        self, gui: viser.GuiApi, driver: "Driver", prefixes: Sequence[str], arms: Sequence[RecordedArm], fps: float
    ):
        self._driver, self._prefixes, self._arms, self._fps = driver, list(prefixes), arms, fps
        self._episode: RecordedEpisode | None = None
        self._flags: Sequence[Flag] | None = None
        self._speed = gui.add_slider("speed of the arms", LEAST_SPEED, MOST_SPEED, 0.1, 0.5)
        self._send = gui.add_button("send to the arms …", color="orange", icon=viser.Icon.ROBOT)
        self._pause = gui.add_button("pause", visible=False, icon=viser.Icon.PLAYER_PAUSE)
        self._end = gui.add_button("end, and hold", visible=False)
        self._bar = gui.add_progress_bar(0.0, visible=False)
        self._send.on_click(self._asked)
        pressed(self._pause, lambda browser: driver.ask(browser, self._toggle))
        pressed(self._end, lambda browser: driver.ask(browser, driver.hold))

    def open(self, episode: RecordedEpisode) -> None:
        """Select the episode to replay."""
        self._episode = episode

    def update(self, flags: Sequence[Flag] | None) -> None:
        """Show the replay's progress. `flags`: check flags of the episode; None if it has not been checked."""
        self._flags = flags
        replayed = self._driver.replayed
        put(self._send, visible=replayed is None)
        for handle in (self._pause, self._end, self._bar):
            put(handle, visible=replayed is not None)
        if replayed is not None:
            put(self._pause, label="go on" if replayed.paused else "pause")
            put(self._bar, value=round(100.0 * replayed.share))

    def _toggle(self) -> None:
        replayed = self._driver.replayed
        if replayed is not None:
            self._driver.pause(not replayed.paused)

    async def _asked(self, event: viser.GuiEvent) -> None:
        client, episode, speed = event.client, self._episode, self._speed.value
        if client is not None and episode is not None:
            self._driver.ask(client.client_id, lambda: self._question(client, episode, speed))

    def _question(self, client: viser.ClientHandle, episode: RecordedEpisode, speed: float) -> None:
        with client.gui.add_modal(f"Send episode {episode.number} to the arms?") as question:
            client.gui.add_html(self._warning(episode, speed))
            yes = client.gui.add_button("move the arms", color="red")
            no = client.gui.add_button("no")

        pressed(yes, lambda browser: self._driver.ask(browser, lambda: self._send_motion(episode, speed)))
        for button in (yes, no):
            pressed(button, lambda _: question.close())

    def _warning(self, episode: RecordedEpisode, speed: float) -> str:
        arms = ", ".join(f"{config.name} ({config.channel})" for config in self._driver.plan.configs)
        kinds = "not checked yet" if self._flags is None else ", ".join(sorted({str(f.kind) for f in self._flags}))
        lines = [
            f"These arms move: <b>{html.escape(arms)}</b>.",
            f"First softly to the first pose of the recording, whatever is in between; then {episode.length} frames "
            f"at {speed:g} x, {episode.length / (self._fps * speed):.0f} s, slower where a joint would be too fast.",
            f"Found in this episode: {html.escape(kinds or 'nothing')}.",
            "Keep away from the arms, and have the emergency stop at hand. They hold when it ends.",
        ]
        return f"<div style='padding:0 0.8em'>{'<br><br>'.join(lines)}</div>"

    def _send_motion(self, episode: RecordedEpisode, speed: float) -> None:
        self._driver.replay(motion_of(self._arms, self._prefixes, episode, self._fps, speed))
