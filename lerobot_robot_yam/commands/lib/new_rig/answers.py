"""Answers of the person at the terminal, kept in a file until the set-up is done: an interrupted one goes on."""

import json
from collections.abc import Callable
from pathlib import Path

from lerobot_robot_yam.commands.lib.arm_command import ask, tell
from lerobot_robot_yam.errors import ConfigError, SetupError
from lerobot_robot_yam.system.paths import write_whole

Check = Callable[[str], str]
"""What an answer means; raises ConfigError: it does not do, and why."""


class Answers:
    """Asks questions, each once.

    Args:
        path: file that keeps the answers.
        sure: do not ask; the usual answers are taken.

    Raises:
        SetupError: the file of an earlier set-up cannot be read.
    """

    def __init__(self, path: Path, sure: bool):
        self._path, self._sure = path, sure
        self._given: dict[str, str] = {}
        try:
            if path.exists():
                self._given = {str(key): str(value) for key, value in json.loads(path.read_text()).items()}
        except (OSError, ValueError, AttributeError) as error:
            raise SetupError(
                f"{path}, the answers of an interrupted set-up, is damaged: delete it ({error})"
            ) from error
        if self._given:
            tell(f"going on with the answers in {path}; delete it to be asked anew")

    def ask(self, question: str, usual: str, check: Check = str) -> str:
        """The answer to a question; Enter takes the usual one.

        Raises:
            ConfigError: the terminal has gone, or nobody may be asked and the usual answer does not do.
        """
        return self.take(question, lambda: ask(f"{question} [{usual}]:") or usual, check, usual)

    def take(self, question: str, get: Callable[[], str], check: Check, usual: str) -> str:
        """The same, got in another way than by typing. Raises ConfigError, see `ask`."""
        if question in self._given:
            try:
                return check(self._given[question])
            except ConfigError:
                del self._given[question]  # things have changed since
        if self._sure:
            return check(usual)
        while True:
            try:
                answer = check(given := get())
            except ConfigError as error:
                tell(str(error))
                continue
            self._given[question] = given
            write_whole(self._path, json.dumps(self._given, indent=1) + "\n")
            return answer

    def forget(self) -> None:
        """The set-up is done."""
        self._path.unlink(missing_ok=True)


def one_of(*words: str) -> Check:
    """A check that takes these words only."""

    def check(answer: str) -> str:
        if answer not in words:
            raise ConfigError(f"{answer!r} is none of {', '.join(words)}")
        return answer

    return check


def number(least: float, most: float) -> Check:
    """A check that takes numbers of this range only."""

    def check(answer: str) -> str:
        try:
            value = float(answer)
        except ValueError as error:
            raise ConfigError(f"{answer!r} is no number") from error
        if not least <= value <= most:
            raise ConfigError(f"{answer} is not within {least:g} … {most:g}")
        return answer

    return check
