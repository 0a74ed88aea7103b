"""The arms of one episode in the scene, at one of its frames."""

from collections.abc import Sequence

import numpy as np
import viser

from lerobot_robot_yam.face.datasets.check.opened_dataset import ACTION, STATE, RecordedEpisode
from lerobot_robot_yam.viewer.data.recorded_arms import RecordedArm
from lerobot_robot_yam.viewer.drawing.figure import Figure
from lerobot_robot_yam.viewer.live.placement import row_of


class RecordedFigures:
    """Figures of all arms that a data set tells of, as they were measured; as they were asked to be, without a state.

    Args:
        scene: of the server.
        root: name of their frame.
        arms: of the data set.
        ghost: in one pale colour.
    """

    def __init__(self, scene: viser.SceneApi, root: str, arms: Sequence[RecordedArm], ghost: bool = False):
        self._arms = arms
        self._figures = [Figure(scene, f"{root}/{arm.prefix or 'arm'}", arm.hardware, ghost) for arm in arms]
        for figure, place in zip(self._figures, row_of(arm.hardware for arm in arms), strict=True):
            figure.stand(*place)
        self._ways: list[np.ndarray | None] = [None] * len(arms)

    def open(self, episode: RecordedEpisode) -> None:
        """Show this episode from now on."""
        self._ways = []
        for arm in self._arms:
            measured = arm.positions(episode, STATE)
            self._ways.append(arm.positions(episode, ACTION) if measured is None else measured)

    def pose(self, frame: int) -> None:
        """Show this frame, or the last one if the episode is shorter."""
        for arm, figure, way in zip(self._arms, self._figures, self._ways, strict=True):
            if way is not None and len(way):
                row, joints = way[min(frame, len(way) - 1)], arm.hardware.joints
                figure.pose(row[:joints], float(row[joints]) if len(row) > joints else None)

    @property
    def visible(self) -> bool:
        """Whether they are shown."""
        return any(figure.visible for figure in self._figures)

    @visible.setter
    def visible(self, shown: bool) -> None:
        for figure in self._figures:
            figure.visible = shown
