"""Dialogue with the person at the terminal: output, tables, questions and their answers."""

import os
import select
import sys
from collections.abc import Sequence

from lerobot_robot_yam.errors import ConfigError

CLEAR_SCREEN = "\x1b[H\x1b[J"


def need_terminal(yes: bool) -> None:
    """Require a terminal or --yes, before anything is done.

    Raises:
        ConfigError: standard input is no terminal, and --yes was not given.
    """
    if not yes and not sys.stdin.isatty():
        raise ConfigError("there is no terminal to confirm at; run it in one, or give --yes")


def ask(question: str) -> str:
    """Read one line from the terminal; the question goes to standard error, so that standard output stays clean.

    Raises:
        ConfigError: the terminal has gone.
    """
    tell(question, end=" ")
    line = sys.stdin.readline()
    if not line:
        raise ConfigError("the terminal gave no answer; nothing more was done")
    return line.strip()


def agreed(question: str) -> bool:
    """Ask; return whether the person answers yes, or just Enter. Raises ConfigError: the terminal has gone."""
    return ask(f"{question} [Y/n]").lower() in ("", "y", "yes")


def typed_line(timeout_s: float) -> str | None:
    """Return a line that is typed within a time, or None. Raises ConfigError: the terminal has gone."""
    if not select.select([sys.stdin], [], [], timeout_s)[0]:
        return None
    line = os.read(sys.stdin.fileno(), 4096)
    if not line:
        raise ConfigError("the terminal has gone; the names that were given stay")
    return line.decode(errors="replace").strip()


def confirm_word(yes: bool, word: str, question: str, left: str = "nothing was energised") -> None:
    """Require --yes, or that the person types the word.

    Raises:
        ConfigError: another word was typed; `left` is the end of the message.
    """
    if not yes and ask(question) != word:
        raise ConfigError(f"not confirmed; {left}")


def tell(text: str, end: str = "\n") -> None:
    """Show words to the person at the terminal, on standard error."""
    sys.stderr.write(text + end)
    sys.stderr.flush()


def say(text: str) -> None:
    """Write a command's output, with a newline."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def tell_landed(landed: bool) -> int:
    """Print whether the arms are down, as returned by `ArmSession.stop`; return the exit status."""
    from lerobot_robot_yam.session.arm_session import still_in_the_air  # loaded by the caller already

    tell("the arms have landed" if landed else still_in_the_air("THE ARMS ARE"))
    return 0 if landed else 1


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a text table, with its columns right-aligned except the first."""
    lines = [head, *rows]
    widths = [max(len(line[i]) for line in lines) for i in range(len(head))]
    return "\n".join(
        "  ".join(c.ljust(w) if i == 0 else c.rjust(w) for i, (c, w) in enumerate(zip(line, widths, strict=True)))
        for line in lines
    )
