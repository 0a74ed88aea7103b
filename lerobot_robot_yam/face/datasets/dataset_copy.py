"""A copy of a data set: it appears under its name only when it is whole, with our side-cars renumbered."""

import json
import logging
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from lerobot_robot_yam.face.recorder import outcomes
from lerobot_robot_yam.face.recorder.kept_episodes import SIDE_CAR
from lerobot_robot_yam.face.recorder.outcomes import OUTCOMES

logger = logging.getLogger(__name__)

SIDE_CARS = (SIDE_CAR, OUTCOMES)  # files of ours beside a data set that tell something of each episode


@contextmanager
def written_aside(target: Path) -> Iterator[Path]:
    """A path beside `target` to create a directory at: it becomes `target` at the end, or is removed after an error.

    Whatever is written beside that path, in the same new directory, is removed at the end.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    # A new name: a directory that exists already, whatever its name, is somebody's, and may be what is copied.
    aside = Path(tempfile.mkdtemp(prefix=f"{target.name}.partial.", dir=target.parent))
    try:
        yield aside / "whole"  # not `aside` itself, which only its owner may read
        (aside / "whole").rename(target)
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def copy_side_cars(root: Path, target: Path, kept: Sequence[int]) -> None:
    """Copy figures and outcomes of the episodes that are left; those of the others would be told of wrong ones.

    Args:
        root: the data set.
        target: the copy; its directory meta exists.
        kept: numbers in `root` of the copy's episodes.

    Raises:
        ConfigError: a line of the outcomes that is none; names it.
    """
    new_numbers = {old: new for new, old in enumerate(kept)}
    labels = outcomes.read(root)
    rows = [replace(label, episode_index=new_numbers[old]) for old, label in labels.items() if old in new_numbers]
    if rows:
        outcomes.append(target, rows)
    if (root / SIDE_CAR).exists():
        (target / SIDE_CAR).write_text("".join(_renumbered(root / SIDE_CAR, new_numbers)), encoding="utf-8")


def _renumbered(path: Path, new_numbers: dict[int, int]) -> list[str]:
    lines = []
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        try:
            row = json.loads(line)
            number = new_numbers.get(row["episode_index"])
        except (ValueError, TypeError, KeyError):  # half a line, which a power cut has left
            logger.warning("%s: a line is no row of figures, and left out: %.40s", path, line)
            continue
        if number is not None:
            lines.append(json.dumps(row | {"episode_index": number}) + "\n")
    return lines
