"""Which LeRobot this package is tested with, and one warning where a newer one is installed."""

import importlib.metadata
import logging
import re

NEWEST_TESTED = "0.6.2"  # the repository's state of August 2026; 0.6.1 is the package index's newest

logger = logging.getLogger(__name__)
_told = False


def warn_if_newer() -> None:
    """Say so, once in a process, when the installed LeRobot is newer than any that this package is tested with."""
    global _told
    if _told:
        return
    _told = True
    try:
        installed = importlib.metadata.version("lerobot")
    except importlib.metadata.PackageNotFoundError:  # a source tree on the path, which has no version
        return
    if _release(installed) > _release(NEWEST_TESTED):
        logger.warning(
            "LeRobot %s is newer than %s, the newest that the YAM driver is tested with. "
            "If something fails, look for a newer driver, or install that LeRobot",
            installed,
            NEWEST_TESTED,
        )


def _release(version: str) -> tuple[int, ...]:
    """The first three numbers of a version, without what says of which pre-release or build it is."""
    return tuple(int(number) for number in re.findall(r"\d+", version)[:3])
