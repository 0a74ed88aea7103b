"""Sends an episode to the arms: asked for, confirmed, watched, paused and ended on the page."""

import html
from collections.abc import Callable, Mapping, Sequence

import viser

from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.face.datasets.check.flags import Flag
from lerobot_robot_yam.face.datasets.check.opened_dataset import RecordedEpisode
from lerobot_robot_yam.session.trajectory import Trajectory
from lerobot_robot_yam.viewer.data.recorded_arms import RecordedArm
from lerobot_robot_yam.viewer.data.replay_driver import Driver
from lerobot_robot_yam.viewer.serving.handles import put

LEAST_SPEED, MOST_SPEED = 0.1, 2.0


def trajectories_of(
    arms: Sequence[RecordedArm], episode: RecordedEpisode, fps: float, speed: float
) -> Mapping[str, Trajectory]:
    """What an episode asks of each arm, by prefix. Raises YamError: it cannot be replayed."""
    return {arm.prefix: arm.trajectory(episode, fps, speed) for arm in arms}


class ReplayDesk:
    """Buttons for the arms. Whoever starts a replay has to stay: when his browser goes, the arms pause.

    Args:
        server: viser's.
        driver: of the arms.
        arms: of the data set.
        fps: of the data set.
        ask: has something done in the loop of the page.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        driver: Driver,
        arms: Sequence[RecordedArm],
        fps: float,
        ask: Callable[[Callable[[], None]], None],
    ):
        self._server, self._driver, self._arms, self._fps = server, driver, arms, fps
        self._episode: RecordedEpisode | None = None
        self._flags: Sequence[Flag] | None = None
        self._starter: int | None = None
        self._refused = ""
        gui = server.gui
        self._speed = gui.add_slider("speed of the arms", LEAST_SPEED, MOST_SPEED, 0.1, 0.5)
        self._send = gui.add_button("send to the arms …", color="orange", icon=viser.Icon.ROBOT)
        self._pause = gui.add_button("pause", visible=False, icon=viser.Icon.PLAYER_PAUSE)
        self._end = gui.add_button("end, and hold", visible=False)
        self._land = gui.add_button("land the arms", visible=False)
        self._bar = gui.add_progress_bar(0.0, visible=False)
        self._said = gui.add_html("")
        self._send.on_click(self._question)
        self._pause.on_click(lambda _: ask(self._toggle))
        self._end.on_click(lambda _: ask(driver.end))
        self._land.on_click(lambda _: ask(lambda: self._carefully(driver.land)))
        self._ask = ask

    def open(self, episode: RecordedEpisode) -> None:
        """What is sent from now on."""
        self._episode = episode

    def update(self, flags: Sequence[Flag] | None) -> None:
        """Show how it stands; `flags`: of the episode, None if it has not been checked."""
        self._flags = flags
        state = self._driver.state
        if state.running and not state.paused and self._starter not in (None, *self._server.get_clients()):
            self._driver.pause()
            self._refused = "paused: the browser that has started the replay is gone"
        for handle, shown in (
            (self._send, not state.running),
            (self._pause, state.running),
            (self._end, state.running),
            (self._land, state.energised),
            (self._bar, state.running),
        ):
            put(handle, visible=shown)
        put(self._pause, label="go on" if state.paused else "pause")
        put(self._bar, value=round(100.0 * state.share))
        put(self._said, content=f"<div style='padding:0 0.8em'>{html.escape(self._refused or state.text)}</div>")

    def _toggle(self) -> None:
        self._refused = ""
        if self._driver.state.paused:
            self._driver.resume()
        else:
            self._driver.pause()

    def _question(self, event: viser.GuiEvent) -> None:
        client, episode, speed = event.client, self._episode, self._speed.value
        if client is None or episode is None:
            return
        with client.gui.add_modal(f"Send episode {episode.number} to the arms?") as question:
            client.gui.add_html(self._warning(episode, speed))
            yes = client.gui.add_button("energise and move", color="red")
            no = client.gui.add_button("no")

        def start(_: viser.GuiEvent) -> None:
            question.close()
            self._ask(lambda: self._start(episode, speed, client.client_id))

        yes.on_click(start)
        no.on_click(lambda _: question.close())

    def _warning(self, episode: RecordedEpisode, speed: float) -> str:
        arms = ", ".join(f"{arm.name} ({arm.config.channel})" for arm in self._driver.arms.values())
        kinds = "not checked yet" if self._flags is None else ", ".join(sorted({str(f.kind) for f in self._flags}))
        lines = [
            f"These arms get torque and move: <b>{html.escape(arms)}</b>.",
            f"First softly to the first pose of the recording, whatever is in between; then {episode.length} frames "
            f"at {speed:g} x, {episode.length / (self._fps * speed):.0f} s, slower where a joint would be too fast.",
            f"Found in this episode: {html.escape(kinds or 'nothing')}.",
            "Keep away from the arms, and have the emergency stop at hand. They hold when it ends.",
        ]
        return f"<div style='padding:0 0.8em'>{'<br><br>'.join(lines)}</div>"

    def _start(self, episode: RecordedEpisode, speed: float, client: int) -> None:
        self._starter = client
        self._carefully(lambda: self._driver.replay(trajectories_of(self._arms, episode, self._fps, speed)))

    def _carefully(self, work: Callable[[], None]) -> None:
        try:
            self._refused = ""
            work()
        except YamError as error:
            self._refused = str(error)

    def close(self) -> None:
        """Land the arms; waits for it. Idempotent."""
        self._driver.close()
