"""Outcomes of episodes: `meta/yam_outcomes.jsonl` beside a data set, one JSON object per line.

The newest line of an episode counts. A line is appended in one write, once LeRobot has saved the episode.
"""

import json
import logging
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from lerobot_robot_yam.errors import ConfigError

logger = logging.getLogger(__name__)

OUTCOMES = Path("meta", "yam_outcomes.jsonl")
SUCCESS, FAILURE, DISCARD = KINDS = ("success", "failure", "discard")


@dataclass(frozen=True)
class Outcome:
    """How an episode ended.

    Attributes:
        episode_index: of the data set.
        outcome: one of `KINDS`; None takes an earlier one back.
        by: the button that said so, or the command.
        at: when, ISO 8601.
    """

    episode_index: int
    outcome: str | None
    by: str
    at: str


def now(episode: int, outcome: str | None, by: str) -> Outcome:
    """An outcome that is told at this moment."""
    return Outcome(episode, outcome, by, datetime.now().astimezone().isoformat(timespec="milliseconds"))


def append(root: Path, outcomes: Sequence[Outcome]) -> None:
    """Write outcomes behind those that are there. Raises OSError: they cannot be written."""
    path = root / OUTCOMES
    text = "".join(f"{json.dumps(asdict(outcome))}\n" for outcome in outcomes)
    if path.exists() and not path.read_bytes().endswith(b"\n") and path.stat().st_size:
        text = "\n" + text  # a power cut has left half a line
    descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
    try:
        os.write(descriptor, text.encode())
    finally:
        os.close(descriptor)


def read(root: Path) -> dict[int, Outcome]:
    """The outcome of each episode that has one.

    Raises:
        ConfigError: a line that is no outcome; names it.
    """
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
