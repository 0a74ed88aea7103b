"""Show, edit and apply the outcomes of a data set's episodes.

yam-label data/NAME                                shows the labels, and what --apply would do
yam-label data/NAME --set 3=failure 5-7=discard    labels episodes; none removes a label
yam-label data/NAME --rest success                 labels all episodes that have no label
yam-label data/NAME --apply                        writes data/NAME_labelled, leaves data/NAME as it is

Labels are success, failure and discard. They are kept in meta/yam_outcomes.jsonl. --apply leaves out the episodes that
are labelled discard, and writes a column of successes. Exit status: 0 success; 1 failure; 2 invalid arguments.
"""

import argparse
import re
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from lerobot_robot_yam.commands.data.dataset_command import add_paths, bar, paths
from lerobot_robot_yam.commands.lib.command_line import command_parser, run_command
from lerobot_robot_yam.commands.lib.dialogue import say, table
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.datasets.layout import INFO, episodes_in
from lerobot_robot_yam.face.recorder import outcomes
from lerobot_robot_yam.face.recorder.outcomes import DISCARD, KINDS, Outcome

_EDIT = re.compile(r"(\d+)(?:-(\d+))?=(\w+)")
_NONE = "none"
_SUFFIX = "_labelled"
_BY = "yam-label"


def _edit(text: str) -> tuple[range, str | None]:
    """Parse a label edit such as 5-7=discard; return the episodes and their outcome, None to remove the outcome."""
    match = _EDIT.fullmatch(text)
    if match is None or match[3] not in (*KINDS, _NONE):
        raise argparse.ArgumentTypeError(
            f"{text!r} is not like 3=failure or 5-7=discard; labels: {', '.join(KINDS)}, none"
        )
    first, last = int(match[1]), int(match[2] or match[1])
    if last < first:
        raise argparse.ArgumentTypeError(f"{text!r}: {last} is before {first}")
    return range(first, last + 1), None if match[3] == _NONE else match[3]


def _edited(
    count: int, labels: Mapping[int, Outcome], edits: Sequence[tuple[range, str | None]], rest: str | None
) -> list[Outcome]:
    """Return the outcomes to append: `edits`, then the outcome `rest` for each episode that is still unlabelled.

    Raises:
        ConfigError: an edit names an episode that the data set does not have.
    """
    wanted: dict[int, str | None] = {}
    for episodes, outcome in edits:
        if episodes[-1] >= count:
            raise ConfigError(f"there is no episode {episodes[-1]}; the data set has {count}, numbered from 0")
        wanted |= dict.fromkeys(episodes, outcome)
    if rest is not None:
        unlabelled = [i for i in range(count) if wanted.get(i, labels.get(i)) is None]
        wanted |= dict.fromkeys(unlabelled, rest)
    return [outcomes.now(episode, outcome, _BY) for episode, outcome in sorted(wanted.items())]


def _show(root: Path, count: int, labels: Mapping[int, Outcome]) -> None:
    from lerobot_robot_yam.face.datasets.check.opened_dataset import open_dataset  # imported late: loads pyarrow

    lengths = {episode.number: episode.metadata.get("length", "–") for episode in open_dataset(root).episodes}
    rows = []
    for episode in range(count):
        label = labels.get(episode)
        told = (label.outcome or "", label.by, label.at[:19]) if label else ("–", "", "")
        rows.append((str(episode), str(lengths.get(episode, "–")), *told))
    say(table(("episode", "frames", "outcome", "by", "at"), rows))
    counts = {kind: sum(label.outcome == kind for label in labels.values()) for kind in KINDS}
    named = ", ".join(f"{number} {kind}" for kind, number in counts.items())
    say(f"{root}: {count} episodes: {named}, {count - sum(counts.values())} without a label")


def label(
    root: Path,
    edits: Sequence[tuple[range, str | None]],
    rest: str | None,
    target: Path | None,
) -> int:
    """Edit and show the outcomes, and apply them to a copy at `target` if given; return the exit status.

    Raises:
        YamError: the data set or its outcomes cannot be read, an episode does not exist, or the copy would be empty.
    """
    count = episodes_in(root)
    if count is None:
        raise ConfigError(f"{root / INFO} cannot be read; if the recording was killed, repair it (yam-repair-dataset)")
    known = {episode: row for episode, row in outcomes.read(root).items() if episode < count}
    written = _edited(count, known, edits, rest)
    if written:
        try:
            outcomes.append(root, written)
        except OSError as error:
            raise ConfigError(f"{root / outcomes.OUTCOMES} cannot be written: {error.strerror}") from error
    labels = {episode: row for episode, row in outcomes.read(root).items() if episode < count}
    _show(root, count, labels)
    dropped = [str(episode) for episode, row in labels.items() if row.outcome == DISCARD]
    drops = f"leaves out episodes {', '.join(dropped)}" if dropped else "leaves out no episode"
    if target is None:
        say(f"--apply {drops} and writes the outcomes of the others into a copy; nothing was copied")
        return 0
    from lerobot_robot_yam.face.datasets.dataset_copy import apply_labels

    apply_labels(root, target, labels, partial(bar, what="loading episodes"))
    say(f"{target}: written, {drops}; loaded again with LeRobot; {root} is as it was")
    return 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `yam-label`; return its exit status."""
    parser = command_parser("yam-label", __doc__)
    add_paths(parser, _SUFFIX)
    parser.add_argument("--set", type=_edit, nargs="+", default=[], metavar="EPISODES=LABEL", help="label episodes")
    parser.add_argument("--rest", choices=KINDS, help="label all episodes that have no label")
    parser.add_argument("--apply", action="store_true", help="write the copy; without it only say what would be done")
    args = parser.parse_args(arguments)
    if args.output is not None and not args.apply:
        parser.error("--output is where --apply writes; add --apply")
    root, target = paths(parser, args, _SUFFIX, writes=args.apply)
    return run_command("yam-label", lambda: label(root, args.set, args.rest, target if args.apply else None))


if __name__ == "__main__":
    sys.exit(main())
