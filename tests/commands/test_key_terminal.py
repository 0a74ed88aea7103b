"""What is read from the terminal of a command that is driven by keys."""

import os
import termios
import threading
import tty

import pytest

from lerobot_robot_yam.commands.lib import key_terminal
from lerobot_robot_yam.commands.lib.key_terminal import KeyTerminal
from lerobot_robot_yam.errors import ConfigError


@pytest.fixture
def keys_and_terminal(monkeypatch):
    """The end at which keys are typed, and the terminal. Time for the rest of a key: 1 s."""
    monkeypatch.setattr(key_terminal, "_SPLIT_S", 1.0)
    keys, terminal = os.openpty()
    tty.setraw(terminal)
    yield keys, KeyTerminal(terminal)
    os.close(terminal)
    os.close(keys)


@pytest.mark.parametrize("pieces", [(b"\x1b[D",), (b"\x1b", b"[D"), (b"\x1b[", b"C"), (b"n",)])
def test_a_key_that_a_slow_line_splits_comes_whole(keys_and_terminal, pieces):
    keys, terminal = keys_and_terminal
    os.write(keys, pieces[0])
    later = [threading.Timer(0.05 * i, os.write, (keys, piece)) for i, piece in enumerate(pieces[1:], 1)]
    for timer in later:
        timer.start()
    assert terminal.keys(1.0) == [b"".join(pieces).decode()]
    for timer in later:
        timer.join()


def test_esc_alone_is_esc(keys_and_terminal, monkeypatch):
    monkeypatch.setattr(key_terminal, "_SPLIT_S", 0.02)
    keys, terminal = keys_and_terminal
    os.write(keys, b"\x1b")
    assert terminal.keys(1.0) == ["\x1b"]
    assert terminal.keys(0.0) == []


def test_a_terminal_that_has_hung_up_is_gone_and_says_nothing():
    keys, descriptor = os.openpty()
    terminal = KeyTerminal(descriptor)
    os.close(keys)
    assert terminal.keys(1.0) == [] and terminal.gone
    os.close(descriptor)


def test_keys_come_at_once_and_the_terminals_mode_is_given_back(type_in):
    descriptor = type_in(b"")
    before = termios.tcgetattr(descriptor)
    with key_terminal.key_terminal() as terminal:
        os.write(descriptor, b"a\x1a")  # Ctrl-Z stops nobody
        assert terminal.keys(1.0) == ["a", "\x1a"]
    assert termios.tcgetattr(descriptor) == before


def test_a_command_in_the_background_is_refused(monkeypatch):
    """At the first key its shell would stop it, and its arm would fall."""
    monkeypatch.setattr("sys.stdin", open(os.devnull))
    monkeypatch.setattr(os, "tcgetpgrp", lambda descriptor: os.getpgrp() + 1)
    with pytest.raises(ConfigError, match="foreground"), key_terminal.key_terminal():
        pass
