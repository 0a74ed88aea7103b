"""A transcript of a page as a script: commands, what they show, what is typed, and what the hands of the person do.

In a block of the language `console` a line is one of:
    $ COMMAND                 runs it; the one before has to end with status 0
    (you do something)        looked up in the actions of the test
    text … text               has to be shown; … stands for anything
    question «answer»         the same, then the answer is typed; «» is Enter alone
"""

import re
import time

from tests.support.pages import blocks
from tests.support.paths import ROOT
from tests.support.terminal import Terminal

_ANSWER = re.compile(r"«(.*)»$")


def lines_of(page):
    """Lines of all transcripts of a page, in order."""
    text = re.sub(r" \\\n *", " ", (ROOT / page).read_text())
    return [line for code in blocks(text, "console") for line in code.splitlines() if line.strip()]


def commands_of(page):
    """The commands of its transcripts."""
    return [line[2:] for line in lines_of(page) if line.startswith("$ ")]


class Play:
    """Plays a transcript in terminals.

    Args:
        directory: for what each terminal leaves behind.
        start: starts the command of a line: the words after "$ " and a directory give a Terminal.
        actions: by the words in the parentheses, what to do.
        timeout_s: for each thing that has to be shown.
    """

    def __init__(self, directory, start, actions, timeout_s=120.0):
        self._directory, self._start, self._actions, self._timeout_s = directory, start, actions, timeout_s
        self._terminal: Terminal | None = None
        self._seen = 0
        self._count = 0

    def run(self, lines):
        """Play the lines to the end of the last command."""
        try:
            for line in lines:
                self._line(line)
            self._end()
        finally:
            if self._terminal is not None:
                self._terminal.close()

    def _line(self, line):
        if line.startswith("$ "):
            self._end()
            self._count += 1
            place = self._directory / f"command_{self._count}"
            place.mkdir()
            self._terminal, self._seen = self._start(line[2:], place), 0
        elif line.startswith("("):
            self._actions[line.strip("()")]()
        else:
            answer = _ANSWER.search(line)
            self._wait(_ANSWER.sub("", line).strip())
            if answer:
                self._terminal.type(answer[1].encode() + b"\n")

    def _wait(self, text):
        pattern = re.compile(".*?".join(map(re.escape, text.split("…"))), re.DOTALL)
        deadline = time.monotonic() + self._timeout_s
        while not (found := pattern.search(self._shown(), self._seen)):
            late = time.monotonic() > deadline or self._terminal.shell.poll() is not None
            assert not late or pattern.search(self._shown(), self._seen), f"not shown: {text}\n{self._shown()[-6000:]}"
            time.sleep(0.05)
        self._seen = found.end()

    def _shown(self):
        return self._terminal.shown.replace("\r\n", "\n")

    def _end(self):
        if self._terminal is not None:
            status = self._terminal.end(self._timeout_s)
            assert status == 0, self._shown()[-6000:]
            self._terminal.close()
