"""Outcomes of episodes: `meta/yam_outcomes.jsonl` beside a data set, one JSON object per line.

The newest line of an episode counts. A line is appended in one write, once LeRobot has saved the episode. Until then
`OutcomeBook` keeps the label, and discards it together with a discarded episode.
"""

import json
import logging
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_robot_yam.errors import ConfigError

logger = logging.getLogger(__name__)

OUTCOMES = Path("meta", "yam_outcomes.jsonl")
SUCCESS, FAILURE, DISCARD = KINDS = ("success", "failure", "discard")


@dataclass(frozen=True)
class Outcome:
    """Outcome of an episode.

    Attributes:
        episode_index: number of the episode in the data set.
        outcome: one of `KINDS`; None cancels an earlier label.
        by: source of the label: a button, or the command.
        at: time of the label, ISO 8601.
    """

    episode_index: int
    outcome: str | None
    by: str
    at: str


def now(episode: int, outcome: str | None, by: str) -> Outcome:
    """Return an outcome with the current time."""
    return Outcome(episode, outcome, by, datetime.now().astimezone().isoformat(timespec="milliseconds"))


def append(root: Path, outcomes: Sequence[Outcome]) -> None:
    """Append outcomes to the file. Raises OSError: the file cannot be written."""
    path = root / OUTCOMES
    text = "".join(f"{json.dumps(asdict(outcome))}\n" for outcome in outcomes)
    if path.exists() and not path.read_bytes().endswith(b"\n") and path.stat().st_size:
        text = "\n" + text  # the file ends with an incomplete line after a power cut
    descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
    try:
        os.write(descriptor, text.encode())
    finally:
        os.close(descriptor)


def read(root: Path) -> dict[int, Outcome]:
    """Return episode number → outcome, for labelled episodes. Raises ConfigError: a line is not a valid outcome."""
    path = root / OUTCOMES
    found: dict[int, Outcome] = {}
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines() if path.exists() else []
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        try:
            outcome = _parsed(json.loads(line))
        except (ValueError, TypeError, KeyError) as error:
            if number == len(lines) or not line.endswith("}"):
                logger.warning("%s: line %d is cut off, and left out", path, number)
                continue
            raise ConfigError(f"{path}: line {number} is no outcome: {error}; correct it or remove it") from error
        found[outcome.episode_index] = outcome
    return {episode: row for episode, row in sorted(found.items()) if row.outcome is not None}


def _parsed(row: Mapping[str, Any]) -> Outcome:
    outcome = Outcome(row["episode_index"], row["outcome"], str(row.get("by", "")), str(row.get("at", "")))
    if type(outcome.episode_index) is not int or outcome.episode_index < 0:
        raise ValueError(f"{outcome.episode_index!r} is no number of an episode")
    if outcome.outcome not in (None, *KINDS):
        raise ValueError(f"{outcome.outcome!r} is none of {', '.join(KINDS)}")
    return outcome


class OutcomeBook:
    """Labels of the episodes that a LeRobot command records into one data set."""

    def __init__(self) -> None:
        self._dataset: Any = None
        self._first = 0  # number of this session's first episode
        self._buffer: Any = None  # LeRobot's buffer of the episode with the pending label
        self._pending: Outcome | None = None

    @property
    def pending(self) -> bool:
        """Whether an episode that is not saved yet has a label."""
        return self._pending is not None

    def open(self, dataset: Any) -> None:
        """Label episodes of this data set from now on. Episodes that it already has belong to an earlier session."""
        if dataset is not None and dataset is not self._dataset:
            self._dataset, self._first, self._pending = dataset, dataset.num_episodes, None
            self._take_back_lost()

    def _take_back_lost(self) -> None:
        """Cancel labels of episodes that were lost afterwards; otherwise the next episodes would inherit them."""
        root = Path(self._dataset.root)
        try:
            lost = [episode for episode in read(root) if episode >= self._first]
            if lost:
                append(root, [now(episode, None, "resumed without it") for episode in lost])
        except (ConfigError, OSError) as error:
            logger.warning("labels of episodes that were lost may remain: %s", error)

    def label(self, outcome: str, frames: int, by: str) -> bool:
        """Label the episode that is not saved yet; without one, label the newest episode of this session.

        Args:
            outcome: one of `KINDS`.
            frames: number of frames of the episode that is not saved yet.
            by: name of the button.

        Returns:
            Whether there is an episode to label.
        """
        if self._dataset is None:
            return False
        buffer, count = _buffer(self._dataset), self._dataset.num_episodes
        if frames and buffer is not None:
            # Use the buffer's number, not the count: LeRobot counts an episode before it replaces the buffer.
            index = int(np.ravel(buffer["episode_index"])[0])
            self._buffer, self._pending = buffer, now(index, outcome, by)
        elif count > self._first:
            self._write(now(count - 1, outcome, by))
        else:
            return False
        return True

    def look(self) -> None:
        """Write the pending label if LeRobot has saved its episode; discard it if LeRobot has discarded the episode."""
        pending = self._pending
        if pending is None:
            return
        buffer = _buffer(self._dataset)  # read before the count: LeRobot counts first, then replaces the buffer
        if self._dataset.num_episodes > pending.episode_index:
            self._pending = self._buffer = None
            self._write(pending)
        elif buffer is not self._buffer:
            self._drop()

    def close(self) -> None:
        """Write or discard the pending label when the data set is closed."""
        self.look()
        if self._pending is not None:
            self._drop()

    def _drop(self) -> None:
        pending, self._pending, self._buffer = self._pending, None, None
        assert pending is not None
        logger.info("episode %d is not kept, nor is its label %s", pending.episode_index, pending.outcome)

    def _write(self, outcome: Outcome) -> None:
        try:
            append(Path(self._dataset.root), [outcome])
            logger.info("episode %d: %s", outcome.episode_index, outcome.outcome)
        except OSError as error:
            logger.warning(
                "episode %d: %s, which could not be written: %s", outcome.episode_index, outcome.outcome, error
            )


def _buffer(dataset: Any) -> Any:
    return dataset.writer.episode_buffer if dataset.writer is not None else None
