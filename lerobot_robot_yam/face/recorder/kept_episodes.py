"""Saving of a recording's finished episodes, for whatever reason the command ends, and a report in its last lines.

LeRobot saves an episode only after the following reset. A signal or an error before that would lose the episode.
"""

import atexit
import functools
import json
import logging
import shlex
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from lerobot_robot_yam.face.datasets.layout import is_empty
from lerobot_robot_yam.face.lerobot_command.running_command import LEAVE_LOOP, STOP, Phase, Situation, recording
from lerobot_robot_yam.face.recorder.outcomes import DISCARD

if TYPE_CHECKING:  # loaded by lerobot-record, and not needed by other commands
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

logger = logging.getLogger(__name__)

SIDE_CAR = Path("meta", "yam_episodes.jsonl")
_MOST = 3  # maximum number of episodes named in the last lines, because a terminal shows few lines
_told_of: "LeRobotDataset | None" = None


def tell_what_is_kept() -> None:
    """Report the kept episodes in the last lines of a recording. Idempotent.

    An empty data set that this command has created is removed, because LeRobot would refuse to create it again.
    """
    global _told_of
    command = recording()
    if command is not None and command.dataset is not _told_of:
        # Imported now, not at exit: an import at exit makes Python forget that an interrupt ends the process, and the
        # exit status would be 1 (see `system.signals`).
        import pyarrow.parquet  # noqa: F401

        import lerobot_robot_yam.face.datasets.check.row_checks  # noqa: F401

        _told_of = command.dataset
        root = Path(command.dataset.root).resolve()  # absolute, because the working directory may change
        atexit.register(_say_kept, command.dataset, root, command.dataset.num_episodes, command.config.resume)


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
    if torn := _torn(root, dataset.num_episodes):
        lines.append(
            f"THE DATA SET DOES NOT LOAD: {torn}. Was the disk full? Make room, then bring back what was saved: "
            f"yam-repair-dataset {quoted}"
        )
        logger.error("%s", "\n  ".join(lines))
        return
    logger.log(logging.WARNING if wrong else logging.INFO, "%s", "\n  ".join(lines))


def _torn(root: Path, episodes: int) -> str:
    """Return what of a closed data set was not written to its end; empty if nothing is missing."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = 0
    for path in sorted([*(root / "data").rglob("*.parquet"), *(root / "meta" / "episodes").rglob("*.parquet")]):
        try:
            count = pq.read_metadata(path).num_rows
        except (pa.ArrowException, OSError):
            return f"{path.relative_to(root)} has no end"
        rows += count if path.is_relative_to(root / "meta") else 0
    return "" if rows >= episodes else f"meta/episodes has {rows} of {episodes} episodes"


def _wrong(root: Path, first: int) -> Iterator[tuple[int, str]]:
    """Yield (number, message) for each episode, from `first` on, whose figures show that it would harm a training."""
    from lerobot_robot_yam.face.datasets.check.row_checks import real_times

    for number, figures in sorted(read_figures(root).items()):
        flags = list(real_times(figures, figures.get("fps", 0.0))) if number >= first else []
        if flags:
            yield number, f"episode {number}: {'; '.join(flag.text for flag in flags)}: {flags[0].kind.remedy}"


def drop_command(quoted_path: str, episodes: Iterable[int]) -> str:
    """Return the command that copies a data set without these episodes."""
    labels = " ".join(f"{episode}={DISCARD}" for episode in episodes)
    return f"yam-label {quoted_path} --set {labels} --apply"


def read_figures(root: Path) -> dict[int, dict[str, Any]]:
    """Return episode number → newest row, from a data set's side-car file."""
    found: dict[int, dict[str, Any]] = {}
    path = root / SIDE_CAR
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines() if path.exists() else []:
        try:
            row = json.loads(line)
            found[row["episode_index"]] = row
        except (ValueError, TypeError, KeyError):  # an incomplete line after a power cut
            continue
    return found


class _SaveThenStop:
    """Value for LeRobot's stop flag, which LeRobot reads before a reset, and again after the save."""

    def __init__(self, now: Situation, why: str):
        self._now, self._why = now, why

    def __bool__(self) -> bool:
        """Return True while a finished episode has to be saved.

        Raises:
            KeyboardInterrupt: the episode is saved, so the command ends now, as by Ctrl-C.
        """
        if self._now.frames:
            return True
        raise KeyboardInterrupt(self._why)


def stop_after_saving(frame: FrameType | None, why: str) -> bool:
    """Delay the effect of a signal until the finished episode is saved.

    Args:
        frame: frame that the signal has interrupted.
        why: text of the KeyboardInterrupt that follows.

    Returns:
        Whether a finished episode is still to be saved, or is being saved. If not, nothing was done.
    """
    now = recording(frame)
    ends_already = sys.exception() is not None  # LeRobot closes the data set, and saves no more episodes
    if now is None or now.phase is Phase.RECORDING or ends_already or not now.frames:
        return False
    now.flags[STOP], now.flags[LEAVE_LOOP] = _SaveThenStop(now, why), True
    first = "drops the episode" if now.drops else "saves the finished episode"
    logger.info("%s: %s first; once more ends it at once", why, first)
    return True


def saves_finished_episode[**P, R](method: Callable[P, R]) -> Callable[P, R]:
    """Decorate a method that LeRobot's loop calls: if it raises during a reset, the finished episode is saved first."""

    @functools.wraps(method)
    def careful(*arguments: P.args, **options: P.kwargs) -> R:
        try:
            return method(*arguments, **options)
        except Exception:
            _save_finished()
            raise

    return careful


def _save_finished() -> None:
    now = recording()
    if now is None or now.phase is not Phase.RESETTING or now.drops or not now.frames:
        return
    logger.info("saves the finished episode before it ends with an error")
    try:
        now.dataset.save_episode()
    except Exception as error:
        logger.error("the finished episode cannot be saved: %r", error)
