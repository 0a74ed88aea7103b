"""Make a recording that was killed (kill -9, out of memory, power) load again.

yam-repair-dataset outputs/my_data --dry-run     says what it would do
yam-repair-dataset outputs/my_data               writes outputs/my_data_repaired, leaves outputs/my_data as it is

Exit status: 0 the data set is healthy, or repaired; 1 nothing can be recovered; 2 wrong arguments.
"""

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from lerobot_robot_yam.commands.data.dataset_command import add_paths, bar, paths
from lerobot_robot_yam.commands.lib.command_line import run_command
from lerobot_robot_yam.commands.lib.dialogue import say

_SUFFIX = "_repaired"


def _ranges(numbers: list[int]) -> str:
    """Format sorted integers as ranges, such as "0–4, 7"."""
    spans: list[list[int]] = []
    for number in numbers:
        if spans and number == spans[-1][1] + 1:
            spans[-1][1] = number
        else:
            spans.append([number, number])
    return ", ".join(f"{a}" if a == b else f"{a}–{b}" for a, b in spans)


def repair(root: Path, target: Path, dry_run: bool = False) -> int:
    """Write a repaired copy of the data set `root` to `target`; return the exit status.

    Raises:
        YamError: the data set cannot be read, or its repaired copy does not load.
    """
    from lerobot_robot_yam.face.datasets.repair.inspection import inspect
    from lerobot_robot_yam.face.datasets.repair.rebuild import rebuild, verify

    findings = inspect(root, partial(bar, what="looking at episodes"))
    kept, lost = findings.kept, [episode for episode in findings.episodes if episode.lost]
    problems = [*findings.problems, *findings.leftovers]
    for problem in problems:
        say(f"  {problem}")
    if not problems and not lost:
        if not dry_run:
            verify(root, partial(bar, what="loading episodes"))
        say(f"{root}: healthy, {len(kept)} episodes")
        return 0
    for episode in lost:
        say(f"  lost: episode {episode.number}: {episode.lost}")
    if not kept:
        say(f"{root}: no episode can be recovered")
        return 1
    numbers = _ranges([episode.number for episode in kept])
    frames = sum(episode.length for episode in kept)
    say(f"  can be recovered: {len(kept)} of {len(findings.episodes)} episodes ({numbers}), {frames} frames")
    if dry_run:
        say(f"{root}: needs repair; nothing was written")
        return 0
    rebuild(findings, target, partial(bar, what="writing and loading"))
    say(f"{target}: written, and loaded again with LeRobot; {root} is as it was")
    if lost and numbers != _ranges(list(range(len(kept)))):
        say("  episodes are numbered anew, from 0, in the order of the numbers above")
    say(f"  to record more into it: --resume=true --dataset.root={target}")
    return 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `yam-repair-dataset`; return its exit status."""
    parser = argparse.ArgumentParser(
        prog="yam-repair-dataset",
        description="Make a LeRobot data set load again whose recording was killed. The original is not changed.",
    )
    add_paths(parser, _SUFFIX)
    parser.add_argument("--dry-run", action="store_true", help="say what can be recovered, write nothing")
    args = parser.parse_args(arguments)
    root, target = paths(parser, args, _SUFFIX, writes=True)
    return run_command("yam-repair-dataset", lambda: repair(root, target, args.dry_run))


if __name__ == "__main__":
    sys.exit(main())
