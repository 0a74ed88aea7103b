"""The episodes of a rollout: frames are added without a gap, then the episode is kept or dropped."""

import logging
from collections.abc import Mapping
from typing import Any

import numpy as np
from lerobot.utils.constants import ACTION, OBS_STR
from lerobot.utils.feature_utils import build_dataset_frame

logger = logging.getLogger(__name__)


class Episodes:
    """Of one data set.

    Args:
        dataset: LeRobot's, open to write.
        features: of its frames.
        task: of each frame.
        longest: frames of an episode at most.

    Attributes:
        saved: how many were kept.
    """

    def __init__(self, dataset: Any, features: Mapping[str, Any], task: str, longest: int):
        self._dataset, self._features, self._task, self._longest = dataset, features, task, longest
        self._frames = self.saved = 0

    @property
    def full(self) -> bool:
        """Whether the present one is as long as it may be."""
        return self._frames >= self._longest

    def add(self, observation: Mapping[str, Any], action: Mapping[str, float], intervention: bool) -> None:
        """Add a frame: what was seen, and what was asked for then; by whom."""
        frame = build_dataset_frame(self._features, observation, prefix=OBS_STR)
        frame |= build_dataset_frame(self._features, action, prefix=ACTION)
        self._dataset.add_frame(frame | {"task": self._task, "intervention": np.array([intervention])})
        self._frames += 1

    def keep(self) -> bool:
        """Save the present one, unless it is empty; whether there was one."""
        if not self._frames:
            return False
        self._dataset.save_episode()
        logger.info("episode %d saved, %d frames", self.saved, self._frames)
        self._frames, self.saved = 0, self.saved + 1
        return True

    def discard(self) -> None:
        """Drop the present one."""
        if self._frames:
            self._dataset.clear_episode_buffer()
            logger.info("episode %d discarded, %d frames", self.saved, self._frames)
            self._frames = 0
