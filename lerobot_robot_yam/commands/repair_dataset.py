"""Make a recording that was killed (kill -9, out of memory, power) load again.

yam-repair-dataset outputs/my_data --dry-run     says what it would do
yam-repair-dataset outputs/my_data               writes outputs/my_data_repaired, leaves outputs/my_data as it is

Exit status: 0 the data set is healthy, or repaired; 1 nothing can be recovered; 2 wrong arguments.
"""

import argparse
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from lerobot_robot_yam.commands.lib.arm_command import run_command
from lerobot_robot_yam.system.paths import user_path


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def _bar(what: str) -> Callable[[Iterable[Any]], Iterable[Any]]:
    """A progress bar around items, shown on a terminal once it takes longer than a second."""
    from tqdm import tqdm

    return lambda items: tqdm(items, what, delay=1.0, leave=False, disable=None)


def _ranges(numbers: list[int]) -> str:
    """Whole numbers in short: "0–4, 7"."""
    spans: list[list[int]] = []
    for number in numbers:
        if spans and number == spans[-1][1] + 1:
            spans[-1][1] = number
        else:
            spans.append([number, number])
    return ", ".join(f"{a}" if a == b else f"{a}–{b}" for a, b in spans)


def repair(root: Path, target: Path, dry_run: bool = False) -> int:
    """Repair a data set into a new directory; returns the exit status.

    Raises:
        YamError: it cannot be read, or what was written does not load.
    """
    from lerobot_robot_yam.face.datasets.repair.inspection import inspect
    from lerobot_robot_yam.face.datasets.repair.rebuild import rebuild, verify

    findings = inspect(root, _bar("looking at episodes"))
    kept, lost = findings.kept, [episode for episode in findings.episodes if episode.lost]
    problems = [*findings.problems, *findings.leftovers]
    for problem in problems:
        _say(f"  {problem}")
    if not problems and not lost:
        if not dry_run:
            verify(root, _bar("loading episodes"))
        _say(f"{root}: healthy, {len(kept)} episodes")
        return 0
    for episode in lost:
        _say(f"  lost: episode {episode.number}: {episode.lost}")
    if not kept:
        _say(f"{root}: no episode can be recovered")
        return 1
    numbers = _ranges([episode.number for episode in kept])
    frames = sum(episode.length for episode in kept)
    _say(f"  can be recovered: {len(kept)} of {len(findings.episodes)} episodes ({numbers}), {frames} frames")
    if dry_run:
        _say(f"{root}: needs repair; nothing was written")
        return 0
    rebuild(findings, target, _bar("writing and loading"))
    _say(f"{target}: written, and loaded again with LeRobot; {root} is as it was")
    if lost and numbers != _ranges(list(range(len(kept)))):
        _say("  episodes are numbered anew, from 0, in the order of the numbers above")
    _say(f"  to record more into it: --resume=true --dataset.root={target}")
    return 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `yam-repair-dataset`; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="yam-repair-dataset",
        description="Make a LeRobot data set load again whose recording was killed. The original is not changed.",
    )
    parser.add_argument("path", type=user_path, help="directory of the data set (--dataset.root of the recording)")
    parser.add_argument("--dry-run", action="store_true", help="say what can be recovered, write nothing")
    parser.add_argument("--output", type=user_path, help="directory of the repaired copy (default: PATH_repaired)")
    args = parser.parse_args(arguments)
    root = args.path.resolve()
    target = (args.output or root.with_name(f"{root.name}_repaired")).resolve()
    if not (root / "meta").is_dir():
        parser.error(f"{args.path} is no LeRobot data set: it has no directory meta")
    if target.exists():
        parser.error(f"{target} exists; choose another directory with --output")
    if target.is_relative_to(root):
        parser.error(f"{target} lies in {root}, which is not to be changed; choose another directory with --output")
    os.environ["HF_HUB_OFFLINE"] = "1"  # LeRobot looks on the Hub for what is missing on disk
    return run_command("yam-repair-dataset", lambda: repair(root, target, args.dry_run))


if __name__ == "__main__":
    sys.exit(main())
