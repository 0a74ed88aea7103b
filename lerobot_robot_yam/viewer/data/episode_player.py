"""Episode player: the playhead, the camera pictures at the current frame, and a plot of one value."""

import contextlib
import threading
from collections.abc import Sequence

import numpy as np
import viser
from viser import uplot

from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.face.datasets.check.opened_dataset import ACTION, STATE, OpenedDataset, RecordedEpisode
from lerobot_robot_yam.face.datasets.dataset_pictures import DatasetPictures
from lerobot_robot_yam.face.datasets.layout import value_names

Wish = tuple[RecordedEpisode, int]
"""An episode and the number of one of its frames."""

_SHOWN_S = 0.2
_POINTS = 600  # maximum number of points per plot: more are not visible at the plot's width
_HEIGHT = 180
_STATE, _ACTION, _OTHER, _NOW = "#1f77b4", "#ff7f0e", "#4682ff88", "#d00"


class Playhead:
    """Playback position in an episode. Times are in the caller's clock, s.

    Attributes:
        frames: number of frames of the episode, at least 1.
        fps: frames per second at speed 1.
        speed: playback speed factor.
        playing: whether the playhead moves. It stops at the last frame.
    """

    def __init__(self, fps: float):
        self.fps, self.speed, self.frames, self.playing = fps, 1.0, 1, False
        self._place = 0.0  # playback position, frames with fraction
        self._then_s: float | None = None

    @property
    def frame(self) -> int:
        """Number of the frame at the playhead."""
        return min(int(self._place), self.frames - 1)

    def open(self, frames: int) -> None:
        """Start another episode at its first frame, paused."""
        self.frames, self.playing, self._place = max(frames, 1), False, 0.0

    def seek(self, frame: int) -> None:
        """Move to a frame, clamped to the episode."""
        self._place = float(min(max(frame, 0), self.frames - 1))

    def play(self) -> None:
        """Start playing. At the last frame, playback restarts from the first one."""
        if self.frame == self.frames - 1:
            self._place = 0.0
        self.playing, self._then_s = True, None

    def pause(self) -> None:
        self.playing = False

    def advance(self, now_s: float) -> int:
        """Advance to the time `now_s`; return the number of the frame to show."""
        if self.playing:
            if self._then_s is not None:
                self._place += (now_s - self._then_s) * self.fps * self.speed
            if self._place >= self.frames - 1:
                self.seek(self.frames - 1)
                self.playing = False
        self._then_s = now_s
        return self.frame


class PictureReader:
    """Thread that reads the pictures of all cameras for one frame at a time. A new request replaces a pending one."""

    def __init__(self, data: OpenedDataset):
        self._data = data
        self._wanted = threading.Condition()
        self._wish: Wish | None = None
        self._read: dict[str, np.ndarray | str] | None = None
        self._ending = False
        self._thread = threading.Thread(target=self._run, name="yam-view-pictures", daemon=True)
        self._thread.start()

    def ask(self, episode: RecordedEpisode, frame: int) -> None:
        """Request the pictures of a frame, replacing a pending request."""
        with self._wanted:
            self._wish = episode, frame
            self._wanted.notify()

    def take(self) -> dict[str, np.ndarray | str] | None:
        """Return camera → picture (height, width, 3) uint8, or its error message; None if nothing is new."""
        with self._wanted:
            read, self._read = self._read, None
        return read

    def _next(self) -> Wish | None:
        with self._wanted:
            self._wanted.wait_for(lambda: self._ending or self._wish is not None)
            wish, self._wish = self._wish, None
            return None if self._ending else wish

    def _run(self) -> None:
        with contextlib.closing(DatasetPictures(self._data)) as pictures:
            while (wish := self._next()) is not None:
                read: dict[str, np.ndarray | str] = {}
                for camera in self._data.cameras:
                    try:
                        read[camera] = pictures.picture(wish[0], camera, wish[1])
                    except YamError as error:
                        read[camera] = str(error)
                with self._wanted:
                    self._read = read

    def close(self) -> None:
        """End the thread. Idempotent."""
        with self._wanted:
            self._ending = True
            self._wanted.notify()
        self._thread.join()


class EpisodePlot:
    """Plot of one value: measured, commanded, and measured in a second episode, with the playhead.

    `gui`: the server's gui; the plot is added to its open container.
    """

    def __init__(self, gui: viser.GuiApi, data: OpenedDataset):
        self._data = data
        self._names = {feature: list(value_names(data.features.get(feature, {}))) for feature in (STATE, ACTION)}
        choice = list(dict.fromkeys([*self._names[STATE], *self._names[ACTION]]))
        self._choice = gui.add_dropdown("plot", choice or ["nothing: the values have no names"])
        series = (
            uplot.Series(label="s"),
            uplot.Series(label="state", stroke=_STATE, width=1.5),
            uplot.Series(label="action", stroke=_ACTION, width=1),
            uplot.Series(label="compared", stroke=_OTHER, width=1.5),
            uplot.Series(label="now", stroke=_NOW, width=0, points=uplot.Series_Points(show=True, size=9, fill=_NOW)),
        )
        nothing = np.zeros(2)
        self._plot = gui.add_uplot(
            (np.array([0.0, 1.0]), nothing, nothing, nothing, nothing),
            series,
            height=_HEIGHT,
            scales={"x": uplot.Scale(time=False)},
        )
        self._shown: tuple[object, ...] = ()
        self._shown_s = -_SHOWN_S

    def update(self, now_s: float, frame: int, episode: RecordedEpisode, other: RecordedEpisode | None) -> None:
        """Redraw the plot with the playhead at `frame`, at most once per `_SHOWN_S`."""
        wanted = (self._choice.value, frame, episode.number, None if other is None else other.number)
        if wanted == self._shown or now_s - self._shown_s < _SHOWN_S or episode.length < 2:
            return
        self._shown, self._shown_s = wanted, now_s
        self._plot.data = curves(self._names, self._choice.value, frame, episode, other, self._data.fps)


def curves(
    names: dict[str, list[str]],
    name: str,
    frame: int,
    episode: RecordedEpisode,
    other: RecordedEpisode | None,
    fps: float,
) -> tuple[np.ndarray, ...]:
    """Return five curves (points,): time (s), state, action, the other episode's state, and the value at `frame` only.

    Missing values are NaN, which the plot leaves out. `names`: feature → names of its values.
    """
    places = np.unique(np.linspace(0, episode.length - 1, min(episode.length, _POINTS)).astype(int))
    state, action = (_values(names[feature], name, episode, feature, places) for feature in (STATE, ACTION))
    compared = np.full(len(places), np.nan)
    if other is not None:
        compared = _values(names[STATE], name, other, STATE, places)
    at = int(np.searchsorted(places, frame).clip(0, len(places) - 1))
    now = np.full(len(places), np.nan)
    now[at] = action[at] if np.isnan(state[at]) else state[at]
    return places / fps, state, action, compared, now


def _values(names: Sequence[str], name: str, episode: RecordedEpisode, feature: str, places: np.ndarray) -> np.ndarray:
    found = np.full(len(places), np.nan)
    if name in names and feature in episode.rows:
        there = places[places < episode.length]
        found[: len(there)] = episode.rows[feature][there, list(names).index(name)]
    return found
