"""The status line: on a terminal only, and out of the way of the log."""

import io
import logging
import os
import pty
import sys

from lerobot_robot_yam.face.recorder.episode_log import StatusLine


class Terminal(io.StringIO):
    """Text that says it goes to a terminal."""

    def isatty(self):
        return True


def lines(text):
    """What a terminal shows in the end, line by line."""
    return [line.rpartition("\r\x1b[K")[2].rstrip("\r") for line in text.split("\n")]


def test_the_log_goes_above_the_line():
    terminal = Terminal()
    handler = logging.StreamHandler(terminal)
    logging.getLogger().addHandler(handler)
    status = StatusLine(terminal)
    try:
        status.begin()
        status.show("episode 1 of 2: 20 s left")
        logging.getLogger().warning("an arm is warm")
        status.show("episode 1 of 2: 19 s left")
        assert lines(terminal.getvalue()) == ["an arm is warm", "episode 1 of 2: 19 s left"]
        status.end()
        logging.getLogger().warning("landed")
        assert lines(terminal.getvalue()) == ["an arm is warm", "landed", ""]
    finally:
        logging.getLogger().removeHandler(handler)


def test_a_file_gets_nothing():
    file = io.StringIO()
    status = StatusLine(file)
    status.begin()
    status.show("episode 1 of 2")
    status.end()
    assert file.getvalue() == ""


def test_a_terminal_that_is_gone_keeps_nobody_from_logging():
    ours, theirs = pty.openpty()
    with os.fdopen(theirs, "w") as terminal:
        status = StatusLine(terminal)
        status.begin()
        status.show("episode 1 of 2")
        os.close(ours)
        status.show("episode 1 of 2")
        logging.getLogger().warning("an arm is warm")
        status.end()
        terminal.close = lambda: None  # its last flush would fail, too


def test_a_program_without_a_terminal_or_a_file_gets_nothing(monkeypatch):
    monkeypatch.setattr(sys, "stderr", None)
    status = StatusLine()
    status.begin()
    status.show("episode 1 of 2")
    status.end()
