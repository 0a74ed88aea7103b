"""Messages at LeRobot's start: that it is newer than tested, and, in one line, that FFmpeg is missing.

LeRobot tries to load torchcodec, which tries FFmpeg 4 to 8, and logs all that was tried as one warning before it reads
videos with PyAV instead, which brings an FFmpeg along. This is replaced only when each attempt has failed because
FFmpeg's libraries are not there. Any other reason (an incompatible torch, a broken FFmpeg) is shown as it is.
"""

import importlib.metadata
import logging
import re

NEWEST_TESTED = "0.6.2"  # the repository's state of August 2026; 0.6.1 is the package index's newest

logger = logging.getLogger(__name__)
_told = False

_LOGGER = "lerobot.utils.import_utils"
_BEGIN, _END = "[start of libtorchcodec loading traceback]", "[end of libtorchcodec loading traceback]"
_ATTEMPT = re.compile(r"^FFmpeg version \d+:\n", re.MULTILINE)
# The innermost exception of an attempt: the system's loader has not found FFmpeg.
_MISSING = re.compile(r"^OSError: lib(?:av|sw)\w+\.so\.\d+: cannot open shared object file: No such file", re.MULTILINE)
_INSTEAD = "FFmpeg's libraries are not installed: LeRobot reads videos with PyAV, which does as well"


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


class _Shorten(logging.Filter):
    """Lets one line pass the first time, and nothing after that."""

    told = False

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether to show a record; one about FFmpeg's absence is shortened."""
        if not _is_absence(record.getMessage()):
            return True
        record.msg, record.args = _INSTEAD, ()
        told, self.told = self.told, True
        return not told


def _is_absence(message: str) -> bool:
    _, begun, rest = message.partition(_BEGIN)
    attempts = _ATTEMPT.split(rest.partition(_END)[0])[1:]
    return bool(begun and attempts) and all(_MISSING.search(attempt) for attempt in attempts)


def shorten_ffmpeg_message() -> None:
    """Shorten LeRobot's warning. Idempotent."""
    logger = logging.getLogger(_LOGGER)
    if not any(isinstance(one, _Shorten) for one in logger.filters):
        logger.addFilter(_Shorten())
