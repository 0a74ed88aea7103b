"""Parser, exit status and error output of a console command."""

import argparse
import logging
import math
from collections.abc import Callable
from typing import Any

from lerobot_robot_yam.commands.lib.dialogue import tell
from lerobot_robot_yam.errors import YamError

_INTERRUPTED = 130  # exit status after Ctrl-C, as in the shell


def command_parser(program: str, text: str | None, **more: Any) -> argparse.ArgumentParser:
    """Return the parser of a command. `text`: help, printed line by line; `more`: arguments of ArgumentParser."""
    form = argparse.RawDescriptionHelpFormatter
    return argparse.ArgumentParser(prog=program, description=text, formatter_class=form, **more)


def seconds(text: str) -> float:
    """Parse a duration on the command line, s. Raises argparse.ArgumentTypeError: it is not finite or not above 0."""
    found = float(text)
    if not 0.0 < found < math.inf:  # also refuses NaN
        raise argparse.ArgumentTypeError(f"give a number of seconds above 0, not {text}")
    return found


def run_command(program: str, work: Callable[[], int]) -> int:
    """Run a command's work and return its exit status; a YamError is printed as one line and gives status 1."""
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(message)s")
    try:
        return work()
    except YamError as error:
        tell(f"{program}: {error}")
        return 1
    except KeyboardInterrupt:
        tell(f"{program}: interrupted")
        return _INTERRUPTED
