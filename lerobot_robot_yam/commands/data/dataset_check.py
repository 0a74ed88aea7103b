"""Check a data set for defects that would harm training or replay: print a table of episodes and all findings.

yam-dataset-check data/NAME                       looks at one picture per second of each camera
yam-dataset-check data/NAME --pictures all        looks at every picture, which takes longer
yam-dataset-check data/NAME --json > report.json

The data set is only read. Exit status: 0 healthy; 1 something was found; 2 wrong use, or no data set.
"""

import json
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from lerobot_robot_yam.commands.data.dataset_command import bar
from lerobot_robot_yam.commands.lib.command_line import command_parser, run_command
from lerobot_robot_yam.commands.lib.dialogue import say, table
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.paths import user_path

if TYPE_CHECKING:
    from lerobot_robot_yam.face.datasets.check.dataset_report import DatasetReport

_EVERY_S = {"sampled": 1.0, "all": 0.0, "none": None}


def _show(report: "DatasetReport") -> None:
    flagged, count = report.flagged, len(report.episodes)
    verdict = "healthy" if report.healthy else "flagged"
    say(f"{report.root}: {verdict}: {len(flagged)} of {count} episodes, {len(report.flags)} flags of its files")
    rows = []
    for episode in report.episodes:
        found = ", ".join(sorted({str(flag.kind) for flag in episode.flags}))
        seconds = f"{episode.frames / report.fps:.1f}"
        rows.append((found or "healthy", str(episode.number), str(episode.frames), seconds))
    say(table(("verdict", "episode", "frames", "s"), rows))
    for flag in report.flags:
        say(f"{flag.kind}: {flag.text}")
    for episode in flagged:
        for flag in episode.flags:
            where = "" if flag.frames is None else f" (frames {flag.frames[0]}–{flag.frames[1]})"
            say(f"episode {episode.number}: {flag.kind}: {flag.text}{where}")


def check(root: Path, pictures: str, arm: str | None, as_json: bool) -> int:
    """Check a data set; return the exit status.

    Raises:
        ConfigError: `root` is not a data set of format v3, or no arm profile is called `arm`.
    """
    from lerobot_robot_yam.face.datasets.check.dataset_report import check_dataset

    show = partial(bar, what="checking episodes")
    report = check_dataset(root, every_s=_EVERY_S[pictures], arm=arm, progress=show)
    if as_json:
        say(json.dumps(report.to_dict(), indent=2))
    else:
        _show(report)
    return 0 if report.healthy else 1


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `yam-dataset-check`; return its exit status."""
    parser = command_parser("yam-dataset-check", __doc__)
    parser.add_argument("path", type=user_path, help="directory of the data set (--dataset.root of the recording)")
    parser.add_argument("--pictures", choices=_EVERY_S, default="sampled", help="how many to look at")
    parser.add_argument("--arm", help="profile with the joint limits (default: the widest of all arms)")
    parser.add_argument("--json", action="store_true", help="the report as JSON, for programs")
    args = parser.parse_args(arguments)
    if not (args.path / "meta").is_dir():
        parser.error(f"{args.path} is no LeRobot data set: it has no directory meta")

    def work() -> int:
        try:
            return check(args.path, args.pictures, args.arm, args.json)
        except ConfigError as error:
            parser.error(str(error))

    return run_command("yam-dataset-check", work)


if __name__ == "__main__":
    sys.exit(main())
