"""Messages that a LeRobot command shows as soon as it loads this package's types:

- LeRobot is newer than tested.
- The command's config file is not valid YAML. LeRobot's reader would end with a traceback without line or cause.
- FFmpeg is not installed. One line replaces LeRobot's page about this: torchcodec tries FFmpeg 4 to 8, and LeRobot logs
  all attempts before it reads videos with PyAV, which has its own FFmpeg. The page stays if the reason was anything but
  missing libraries.
"""

import functools
import importlib.metadata
import logging
import re
import sys
from pathlib import Path

NEWEST_TESTED = "0.6.2"  # newest tested version: the repository's of August 2026; the package index has 0.6.1

_OPTION = "--config_path="
_BAD_OPTIONS = 2  # exit status of a command that refuses its options, the same as argparse's

_BEGIN, _END = "[start of libtorchcodec loading traceback]", "[end of libtorchcodec loading traceback]"
_ATTEMPT = re.compile(r"^FFmpeg version \d+:\n", re.MULTILINE)
# Innermost exception of an attempt that failed because the system's loader did not find FFmpeg.
_MISSING = re.compile(r"^OSError: lib(?:av|sw)\w+\.so\.\d+: cannot open shared object file: No such file", re.MULTILINE)
_INSTEAD = "FFmpeg's libraries are not installed: LeRobot reads videos with PyAV, which does as well"

logger = logging.getLogger(__name__)


@functools.cache  # once per process
def warn_if_newer() -> None:
    """Warn if the installed LeRobot is newer than the newest tested one."""
    try:
        installed = importlib.metadata.version("lerobot")
    except importlib.metadata.PackageNotFoundError:  # a source tree has no version
        return
    if _release(installed) > _release(NEWEST_TESTED):
        logger.warning(
            "LeRobot %s is newer than %s, the newest that the YAM driver is tested with. "
            "If something fails, look for a newer driver, or install that LeRobot",
            installed,
            NEWEST_TESTED,
        )


def _release(version: str) -> tuple[int, ...]:
    """Return the first three numbers of a version, without the suffix of a pre-release or build."""
    return tuple(int(number) for number in re.findall(r"\d+", version)[:3])


def refuse_unreadable() -> None:
    """End a LeRobot command whose config file is not valid YAML. Other mistakes in the file are left to LeRobot.

    Raises:
        SystemExit: after a message with file, line and cause.
    """
    if not Path(*sys.argv[:1]).stem.startswith("lerobot"):
        return
    given = next((argument for argument in sys.argv[1:] if argument.startswith(_OPTION)), _OPTION)
    path = Path(given.removeprefix(_OPTION))
    if path.suffix not in (".yaml", ".yml"):
        return
    import yaml  # late import, because all processes of this package load this module

    try:
        yaml.safe_load(path.read_text())
    except (OSError, UnicodeDecodeError):
        return
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f", line {mark.line + 1}" if mark else ""
        problem = getattr(error, "problem", None) or "cannot be read"
        cause = "a tab; indent with blanks" if "'\\t'" in problem else f"{problem}; it is no YAML"
        sys.stderr.write(f"error: {path}{line}: {cause}\n")
        raise SystemExit(_BAD_OPTIONS) from None


def shorten_page_about_ffmpeg() -> None:
    """Replace LeRobot's page about missing FFmpeg libraries by one line, once. Idempotent."""
    logging.getLogger("lerobot.utils.import_utils").addFilter(_shorten)


class _Shorten(logging.Filter):
    """Filter that shows one line the first time, and nothing after that."""

    told = False

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether to show a record. A record about missing FFmpeg libraries is shortened."""
        if not _is_absence(record.getMessage()):
            return True
        record.msg, record.args = _INSTEAD, ()
        record.levelno, record.levelname = logging.INFO, "INFO"
        told, self.told = self.told, True
        return not told


_shorten = _Shorten()


def _is_absence(message: str) -> bool:
    _, begun, rest = message.partition(_BEGIN)
    attempts = _ATTEMPT.split(rest.partition(_END)[0])[1:]
    return bool(begun and attempts) and all(_MISSING.search(attempt) for attempt in attempts)
