"""Data part of the page: plays a data set's episodes in 3-D with their pictures, and sends episodes to the arms."""

import contextlib
import html
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import viser

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.datasets.check.flags import Flag
from lerobot_robot_yam.face.datasets.check.opened_dataset import open_dataset
from lerobot_robot_yam.face.recorder import outcomes
from lerobot_robot_yam.viewer.data.episode_list import BackgroundCheck, EpisodeList, describe
from lerobot_robot_yam.viewer.data.episode_player import EpisodePlot, PictureReader, Playhead
from lerobot_robot_yam.viewer.data.recorded_arms import ARM, GRIPPER, RecordedFigures, recorded_arms
from lerobot_robot_yam.viewer.data.replay_desk import ReplayDesk
from lerobot_robot_yam.viewer.data.scene_match import SceneMatch
from lerobot_robot_yam.viewer.serving.handles import put

if TYPE_CHECKING:  # the driver loads the inverse kinematics, not needed by a page without arms
    from lerobot_robot_yam.viewer.moving.driver import Driver

_WIDTH_PX = 380
_SUCCESS_COLUMN = "success"  # column of the episode metadata in data sets copied by yam-label
_CONTROL = "`connect …` and `take control` come first, in the panel `move`; `land` is there, too."
_NO_DRIVER = "To send an episode to arms, start `yam-view` with `--config_path` of a run config that has them."


class DataPart:
    """Part of the page that shows one data set.

    Args:
        server: viser's server.
        root: directory of the data set.
        known: value prefix → config of the arm, from a run config.
        cameras: name → camera options from the run config.
        arm, gripper: profiles of arms that are not in `known`.
        driver: driver of the arms in `known`, in the same order, for sending episodes to them; or None.

    Raises:
        ConfigError: `root` is not a v3 data set, has no episodes, or does not match the profiles.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        root: Path,
        *,
        known: Mapping[str, ArmConfig] | None = None,
        cameras: Mapping[str, Mapping[str, Any]] | None = None,
        arm: str = ARM,
        gripper: str = GRIPPER,
        driver: "Driver | None" = None,
    ):
        known = known or {}
        self._data = data = open_dataset(root)
        self._episodes = {episode.number: episode for episode in data.episodes if episode.length}
        if not self._episodes:
            raise ConfigError(f"{root} has no episodes with rows")
        labels = _labels(root, data.episodes)
        arms = recorded_arms(data, known, arm, gripper)
        self._figures = RecordedFigures(server.scene, "/recorded", arms)
        self._ghosts = RecordedFigures(server.scene, "/compared", arms, ghost=True)
        self._asked: deque[Callable[[], None]] = deque()
        self._playhead = Playhead(data.fps)
        self._chosen = self._compared = -1
        self._shown: tuple[int, int, int] | None = None
        self._pictures: dict[str, np.ndarray | str] = {}
        self._check = BackgroundCheck(data)
        self._reader = PictureReader(data)
        gui = server.gui
        panel = gui.add_panel()
        with panel.add_tab("Data set", viser.Icon.DATABASE):
            self._list = EpisodeList(gui, data, labels, self._check)
        with panel.add_tab("Match a scene", viser.Icon.LAYERS_INTERSECT):
            self._match = SceneMatch(gui, data.cameras, cameras or {}, list(known.values()))
        with panel.add_tab("Send to the arms", viser.Icon.ROBOT):
            self._desk = None if driver is None else ReplayDesk(gui, driver, list(known), arms, data.fps)
            gui.add_markdown(_NO_DRIVER if driver is None else _CONTROL)
        episode_panel = gui.add_panel()
        with episode_panel.add_tab("Episode", viser.Icon.PLAYER_PLAY):
            self._add_player(gui)
            self._plot = EpisodePlot(gui, data)
        panel.dock_left()
        panel.set_width(_WIDTH_PX)
        episode_panel.dock_below(panel)
        self._open(min(self._episodes))
        self._check.start()

    def _add_player(self, gui: viser.GuiApi) -> None:
        last = max(self._episodes)
        self._number = gui.add_number("episode", min(self._episodes), min=0, max=last, step=1)
        self._slider = gui.add_slider("frame", 0, 1, 1, 0)
        self._slid = 0  # slider value that was last set by this object
        self._play = gui.add_button("play", icon=viser.Icon.PLAYER_PLAY)
        self._speed = gui.add_slider("speed", 0.1, 2.0, 0.1, 1.0)
        self._next = gui.add_button("go to the next flag")
        self._said = gui.add_html("")
        self._other = gui.add_number("compare with", -1, min=-1, max=last, step=1, hint="its ghost; -1: none")
        self._in_3d = gui.add_checkbox("figures", True)
        self._images = {
            camera: gui.add_image(np.zeros((2, 2, 3), np.uint8), format="jpeg", label=camera.rpartition(".")[2])
            for camera in self._data.cameras
        }
        self._missing = gui.add_html("")
        self._play.on_click(lambda _: self._asked.append(self._toggle))
        self._next.on_click(lambda _: self._asked.append(self._go_to_flag))

    def _open(self, number: int) -> None:
        episode = self._episodes[number]
        self._chosen = number
        self._playhead.open(episode.length)
        self._figures.open(episode)
        put(self._slider, max=max(episode.length - 1, 1), value=0)
        self._slid = 0
        self._shown = None
        if self._desk is not None:
            self._desk.open(episode)

    @property
    def _flags(self) -> Sequence[Flag] | None:
        report = self._check.found().get(self._chosen)
        return None if report is None else report.flags

    def _toggle(self) -> None:
        if self._playhead.playing:
            self._playhead.pause()
        else:
            self._playhead.play()

    def _go_to_flag(self) -> None:
        starts = sorted({flag.frames[0] for flag in self._flags or () if flag.frames is not None})
        if starts:
            self._playhead.pause()
            self._playhead.seek(next((start for start in starts if start > self._playhead.frame), starts[0]))

    def update(self, now_s: float) -> None:
        """Process button presses, and show the frame at the playhead."""
        while self._asked:
            self._asked.popleft()()
        self._choose()
        if self._slider.value != self._slid:  # moved by a person
            self._playhead.pause()
            self._playhead.seek(self._slider.value)
        self._playhead.speed = self._speed.value
        frame = self._playhead.advance(now_s)
        put(self._slider, value=frame)
        self._slid = frame
        self._show(now_s, frame)
        self._list.update(now_s, self._chosen)
        self._match.update(now_s, self._pictures)
        if self._desk is not None:
            self._desk.update(self._flags)

    def _choose(self) -> None:
        wanted = int(self._number.value)
        if wanted != self._chosen and wanted in self._episodes:
            self._open(wanted)
        other = int(self._other.value)
        if other != self._compared:
            self._compared = other
            self._shown = None
            if other in self._episodes:
                self._ghosts.open(self._episodes[other])

    def _show(self, now_s: float, frame: int) -> None:
        episode, other = self._episodes[self._chosen], self._episodes.get(self._compared)
        wanted = (self._chosen, self._compared, frame)
        if wanted != self._shown:
            self._shown = wanted
            self._figures.pose(frame)
            if other is not None:
                self._ghosts.pose(frame)
            self._reader.ask(episode, frame)
        self._figures.visible = self._in_3d.value
        self._ghosts.visible = self._in_3d.value and other is not None
        put(self._play, label="pause" if self._playhead.playing else "play")
        put(self._said, content=describe(self._flags))
        self._plot.update(now_s, frame, episode, other)
        self._show_pictures()

    def _show_pictures(self) -> None:
        read = self._reader.take()
        if read is None:
            return
        self._pictures = read
        for camera, image in self._images.items():
            found = read[camera]
            put(image, visible=isinstance(found, np.ndarray))
            if isinstance(found, np.ndarray):
                image.image = found
        missing = "<br>".join(html.escape(found) for found in read.values() if isinstance(found, str))
        put(self._missing, content=missing)

    def close(self) -> None:
        """Release the cameras and end the threads. Idempotent."""
        with contextlib.ExitStack() as last_first:
            for part in (self._check, self._reader, self._match):
                last_first.callback(part.close)


def _labels(root: Path, episodes: Sequence[Any]) -> dict[int, str]:
    """Return episode → outcome, from the outcomes file, or else from the success column of a labelled copy.

    Raises:
        ConfigError: a line of the outcomes file is invalid.
    """
    found = {
        episode.number: outcomes.SUCCESS if episode.metadata[_SUCCESS_COLUMN] else outcomes.FAILURE
        for episode in episodes
        if episode.metadata.get(_SUCCESS_COLUMN) is not None
    }
    told = {number: str(row.outcome) for number, row in outcomes.read(root).items()}
    return found | told
