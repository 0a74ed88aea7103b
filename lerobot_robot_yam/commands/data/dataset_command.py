"""Path arguments and progress bar of the commands that work on data sets."""

import argparse
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from lerobot_robot_yam.system.paths import user_path


def add_paths(parser: argparse.ArgumentParser, suffix: str) -> None:
    """Add the arguments for the paths of the data set and its copy, whose default is the data set's path + `suffix`."""
    parser.add_argument("path", type=user_path, help="directory of the data set (--dataset.root of the recording)")
    parser.add_argument("--output", type=user_path, help=f"directory of the copy (default: PATH{suffix})")


def paths(parser: argparse.ArgumentParser, args: argparse.Namespace, suffix: str, writes: bool) -> tuple[Path, Path]:
    """Return the paths of the data set and its copy; exit with a usage error if either path cannot be used.

    Also sets HF_HUB_OFFLINE, so that LeRobot does not search the Hub for files that are missing on disk.
    """
    root = args.path.resolve()
    target = (args.output or root.with_name(f"{root.name}{suffix}")).resolve()
    if not (root / "meta").is_dir():
        parser.error(f"{args.path} is no LeRobot data set: it has no directory meta")
    if writes and target.exists():
        parser.error(f"{target} exists; choose another directory with --output")
    if target.is_relative_to(root):
        parser.error(f"{target} lies in {root}, which is not to be changed; choose another directory with --output")
    os.environ["HF_HUB_OFFLINE"] = "1"
    return root, target


def bar(items: Iterable[Any], what: str) -> Iterable[Any]:
    """Wrap the items in a progress bar, shown on a terminal if the work takes longer than 1 s."""
    from tqdm import tqdm

    return tqdm(items, what, delay=1.0, leave=False, disable=None)
