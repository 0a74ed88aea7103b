"""The last lines of a recording: which episodes are kept, what is wrong with them, and what to do."""

import atexit
import json
import logging
import shlex
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from lerobot_robot_yam.face.recorder.outcomes import DISCARD
from lerobot_robot_yam.face.recorder.record_command import is_empty, running_record

if TYPE_CHECKING:  # the command has loaded it, other commands need not
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

logger = logging.getLogger(__name__)

SIDE_CAR = Path("meta", "yam_episodes.jsonl")
_MOST = 3  # episodes that the last lines name; a terminal shows few lines
_told_of: "LeRobotDataset | None" = None


def tell_what_is_kept(frame: FrameType | None) -> None:
    """Have the last lines of a recording say which episodes are kept. Idempotent.

    A data set that this command has made and that holds nothing is removed: it would refuse the same command.
    """
    global _told_of
    command = running_record(frame)
    if command is not None and command.dataset is not _told_of:
        # Here, not at exit: a module that is loaded then makes Python forget that an interrupt ends the process, and
        # its exit status would be 1 (see `system.signals`).
        import lerobot_robot_yam.face.datasets.check.row_checks  # noqa: F401

        _told_of = command.dataset
        root = Path(command.dataset.root).resolve()  # the working directory may change
        atexit.register(_say_kept, command.dataset, root, command.dataset.num_episodes, command.resumes)


def _say_kept(dataset: "LeRobotDataset", root: Path, before: int, resumes: bool) -> None:
    if not resumes and is_empty(root):
        shutil.rmtree(root, ignore_errors=True)
        if not root.exists():
            logger.info("no episode was recorded; removed the empty data set %s", root)
            return
    count = dataset.num_episodes - before
    kept = "no episode" if not count else f"{count} episode{'s' if count > 1 else ''}"
    wrong, quoted = dict(_wrong(root, before)), shlex.quote(str(root))
    lines = [f"kept {kept} of this session; {dataset.num_episodes} in {root}", *list(wrong.values())[:_MOST]]
    if len(wrong) > _MOST:
        lines.append(f"and {len(wrong) - _MOST} more; see yam-dataset-check {quoted}")
    if 0 < len(wrong) < dataset.num_episodes:
        lines.append(f"to have a copy without {'it' if len(wrong) == 1 else 'them'}: {drop_command(quoted, wrong)}")
    logger.log(logging.WARNING if wrong else logging.INFO, "%s", "\n  ".join(lines))


def _wrong(root: Path, first: int) -> Iterator[tuple[int, str]]:
    """Number of each episode from `first` on whose figures say that it harms a training, and what it is."""
    from lerobot_robot_yam.face.datasets.check.flags import KINDS
    from lerobot_robot_yam.face.datasets.check.row_checks import real_times

    for number, figures in sorted(read_figures(root).items()):
        flags = list(real_times(figures, figures.get("fps", 0.0))) if number >= first else []
        if flags:
            yield number, f"episode {number}: {'; '.join(flag.text for flag in flags)}: {KINDS[flags[0].kind][1]}"


def drop_command(quoted_path: str, episodes: Iterable[int]) -> str:
    """What writes a copy of a data set without some episodes."""
    labels = " ".join(f"{episode}={DISCARD}" for episode in episodes)
    return f"yam-label {quoted_path} --set {labels} --apply"


def read_figures(root: Path) -> dict[int, dict[str, Any]]:
    """Rows of a data set's side-car by episode; the newest of an episode counts."""
    found: dict[int, dict[str, Any]] = {}
    path = root / SIDE_CAR
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines() if path.exists() else []:
        try:
            row = json.loads(line)
            found[row["episode_index"]] = row
        except (ValueError, TypeError, KeyError):  # half a line, which a power cut has left
            continue
    return found
