"""A source tree of LeRobot in place of the installed one, for this process and all that it starts."""

import os
import sys
import tomllib
from pathlib import Path


def use(tree: Path, directory: Path) -> None:
    """Put the tree before what is installed, its metadata included, so that it has its own version everywhere.

    Args:
        tree: a checkout of LeRobot.
        directory: an empty directory to keep until the last process has ended.

    Raises:
        FileNotFoundError: the tree is no checkout of LeRobot.
    """
    version = tomllib.loads((tree / "pyproject.toml").read_text())["project"]["version"]
    (directory / "lerobot").symlink_to((tree / "src" / "lerobot").resolve(strict=True), target_is_directory=True)
    metadata = directory / f"lerobot-{version}.dist-info" / "METADATA"
    metadata.parent.mkdir()
    metadata.write_text(f"Metadata-Version: 2.1\nName: lerobot\nVersion: {version}\n")
    sys.path.insert(0, str(directory))
    os.environ["PYTHONPATH"] = os.pathsep.join([str(directory), *filter(None, [os.environ.get("PYTHONPATH")])])
