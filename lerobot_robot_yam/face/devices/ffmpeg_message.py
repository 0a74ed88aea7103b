"""One line in place of LeRobot's five tracebacks where FFmpeg is not installed.

LeRobot tries to load torchcodec, which tries FFmpeg 4 to 8, and logs all that was tried as one warning before it reads
videos with PyAV instead, which brings an FFmpeg along. This is replaced only when each attempt has failed because
FFmpeg's libraries are not there. Any other reason (an incompatible torch, a broken FFmpeg) is shown as it is.
"""

import logging
import re

_LOGGER = "lerobot.utils.import_utils"
_BEGIN, _END = "[start of libtorchcodec loading traceback]", "[end of libtorchcodec loading traceback]"
_ATTEMPT = re.compile(r"^FFmpeg version \d+:\n", re.MULTILINE)
# The innermost exception of an attempt: the system's loader has not found FFmpeg.
_MISSING = re.compile(r"^OSError: lib(?:av|sw)\w+\.so\.\d+: cannot open shared object file: No such file", re.MULTILINE)
_INSTEAD = "FFmpeg's libraries are not installed: LeRobot reads videos with PyAV, which does as well"


class _Shorten(logging.Filter):
    """Lets one line pass the first time, and nothing after that."""

    told = False

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether a record is to be shown; one about FFmpeg's absence is shortened."""
        if not _is_absence(record.getMessage()):
            return True
        record.msg, record.args = _INSTEAD, ()
        told, self.told = self.told, True
        return not told


def _is_absence(message: str) -> bool:
    _, begun, rest = message.partition(_BEGIN)
    attempts = _ATTEMPT.split(rest.partition(_END)[0])[1:]
    return bool(begun and attempts) and all(_MISSING.search(attempt) for attempt in attempts)


def shorten() -> None:
    """Install this for LeRobot's logger of that warning. Idempotent."""
    logger = logging.getLogger(_LOGGER)
    if not any(isinstance(one, _Shorten) for one in logger.filters):
        logger.addFilter(_Shorten())
