"""Terminal input and output of the commands: messages, tables, questions and confirmations."""

import os
import select
import sys
from collections.abc import Sequence

from lerobot_robot_yam.errors import ConfigError

CLEAR_SCREEN = "\x1b[H\x1b[J"


def need_terminal(yes: bool) -> None:
    """Check that the command can ask for confirmation, or needs none because of --yes.

    Raises:
        ConfigError: standard input is not a terminal, and --yes was not given.
    """
    if not yes and not sys.stdin.isatty():
        raise ConfigError("there is no terminal to confirm at; run it in one, or give --yes")


def ask(question: str) -> str:
    """Ask a question and return the line typed. The question goes to standard error, to keep standard output clean.

    Raises:
        ConfigError: the terminal was closed.
    """
    tell(question, end=" ")
    line = sys.stdin.readline()
    if not line:
        raise ConfigError("the terminal gave no answer; nothing more was done")
    return line.strip()


def agreed(question: str) -> bool:
    """Return whether the user answers yes or presses Enter alone. Raises ConfigError: the terminal was closed."""
    return ask(f"{question} [Y/n]").lower() in ("", "y", "yes")


def typed_line(timeout_s: float) -> str | None:
    """Return the line typed within `timeout_s`, or None. Raises ConfigError: the terminal was closed."""
    if not select.select([sys.stdin], [], [], timeout_s)[0]:
        return None
    line = os.read(sys.stdin.fileno(), 4096)
    if not line:
        raise ConfigError("the terminal has gone; the names that were given stay")
    return line.decode(errors="replace").strip()


def confirm_word(yes: bool, word: str, question: str, left: str = "nothing was energised") -> None:
    """Require --yes, or that the user types `word`.

    Raises:
        ConfigError: the user typed something else; `left` ends the message.
    """
    if not yes and ask(question) != word:
        raise ConfigError(f"not confirmed; {left}")


def tell(text: str, end: str = "\n") -> None:
    """Print a message for the user to standard error."""
    sys.stderr.write(text + end)
    sys.stderr.flush()


def say(text: str) -> None:
    """Print a command's result to standard output."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def tell_landed(landed: bool) -> int:
    """Print whether the arms have landed, as returned by `ArmSession.stop`; return the exit status."""
    from lerobot_robot_yam.session.arm_session import still_in_the_air  # no extra import cost: the caller has loaded it

    tell("the arms have landed" if landed else still_in_the_air("THE ARMS ARE"))
    return 0 if landed else 1


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a text table; all columns except the first are right-aligned."""
    lines = [head, *rows]
    widths = [max(len(line[i]) for line in lines) for i in range(len(head))]
    return "\n".join(
        "  ".join(c.ljust(w) if i == 0 else c.rjust(w) for i, (c, w) in enumerate(zip(line, widths, strict=True)))
        for line in lines
    )
