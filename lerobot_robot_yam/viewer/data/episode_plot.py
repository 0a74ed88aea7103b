"""A plot of one value of an episode: measured and asked for, and where one is; beside it, those of another episode."""

from collections.abc import Sequence

import numpy as np
import viser
from viser import uplot

from lerobot_robot_yam.face.datasets.check.opened_dataset import ACTION, STATE, OpenedDataset, RecordedEpisode
from lerobot_robot_yam.face.datasets.layout import value_names

_SHOWN_S = 0.2
_POINTS = 600  # more cannot be told apart on so small a plot
_HEIGHT = 180
_STATE, _ACTION, _OTHER, _NOW = "#1f77b4", "#ff7f0e", "#4682ff88", "#d00"


class EpisodePlot:
    """One plot, and a choice of the value.

    Args:
        gui: of the server, inside the container that the plot is to be in.
        data: the data set.
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
        """Show this frame; at most a few times a second."""
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
    """Time (s), state, action, state of the other episode, and the state at `frame` alone: (points,) each.

    What does not exist is NaN, which is not drawn.

    Args:
        names: of the values, by feature.
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
