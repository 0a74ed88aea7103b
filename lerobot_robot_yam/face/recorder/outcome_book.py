"""Labels of the episodes that a LeRobot command records: kept until it has saved them, dropped with them."""

import logging
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.recorder import outcomes

logger = logging.getLogger(__name__)


class OutcomeBook:
    """Of one data set while it is written."""

    def __init__(self) -> None:
        self._dataset: Any = None
        self._first = 0  # episode of this session
        self._buffer: Any = None  # LeRobot's, of the episode with the pending label
        self._pending: outcomes.Outcome | None = None

    @property
    def pending(self) -> bool:
        """Whether an episode that is not saved yet has a label."""
        return self._pending is not None

    def open(self, dataset: Any) -> None:
        """From now on labels are for this data set; the episodes that it has are an earlier session's."""
        if dataset is not None and dataset is not self._dataset:
            self._dataset, self._first, self._pending = dataset, dataset.num_episodes, None
            self._take_back_lost()

    def _take_back_lost(self) -> None:
        """An episode that was labelled and then lost has left its label, which the next one would inherit."""
        root = Path(self._dataset.root)
        try:
            lost = [episode for episode in outcomes.read(root) if episode >= self._first]
            if lost:
                outcomes.append(root, [outcomes.now(episode, None, "resumed without it") for episode in lost])
        except (ConfigError, OSError) as error:
            logger.warning("labels of episodes that were lost may remain: %s", error)

    def label(self, outcome: str, frames: int, by: str) -> bool:
        """Label the episode that is not saved yet, or else the newest one of this session.

        Args:
            outcome: one of `outcomes.KINDS`.
            frames: of the episode that is not saved yet.
            by: the button.

        Returns:
            False: there is no such episode.
        """
        if self._dataset is None:
            return False
        buffer, count = _buffer(self._dataset), self._dataset.num_episodes
        if frames and buffer is not None:
            # Its own number, not the count: LeRobot counts it before it has encoded videos and taken a new buffer.
            index = int(np.ravel(buffer["episode_index"])[0])
            self._buffer, self._pending = buffer, outcomes.now(index, outcome, by)
        elif count > self._first:
            self._write(outcomes.now(count - 1, outcome, by))
        else:
            return False
        return True

    def look(self) -> None:
        """Write the pending label if LeRobot has saved its episode; drop it if LeRobot has dropped that."""
        pending = self._pending
        if pending is None:
            return
        buffer = _buffer(self._dataset)  # before the count: LeRobot counts first, then takes a new buffer
        if self._dataset.num_episodes > pending.episode_index:
            self._pending = self._buffer = None
            self._write(pending)
        elif buffer is not self._buffer:
            self._drop()

    def close(self) -> None:
        """The data set is closed."""
        self.look()
        if self._pending is not None:
            self._drop()

    def _drop(self) -> None:
        pending, self._pending, self._buffer = self._pending, None, None
        assert pending is not None
        logger.info("episode %d is not kept, nor is its label %s", pending.episode_index, pending.outcome)

    def _write(self, outcome: outcomes.Outcome) -> None:
        try:
            outcomes.append(Path(self._dataset.root), [outcome])
            logger.info("episode %d: %s", outcome.episode_index, outcome.outcome)
        except OSError as error:
            logger.warning(
                "episode %d: %s, which could not be written: %s", outcome.episode_index, outcome.outcome, error
            )


def _buffer(dataset: Any) -> Any:
    return dataset.writer.episode_buffer if dataset.writer is not None else None
