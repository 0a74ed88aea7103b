"""What is read from a user's terminal."""

import os
import termios
import threading
import tty

import pytest

from lerobot_robot_yam.face.operator_keys import pseudo_terminal, user_terminal
from lerobot_robot_yam.face.operator_keys.pseudo_terminal import PseudoTerminal
from lerobot_robot_yam.face.operator_keys.user_terminal import UserTerminal


@pytest.fixture
def keys_and_terminal(monkeypatch):
    """The end at which keys are typed, and the terminal, which hands on each byte. Time for the rest of a key: 1 s."""
    monkeypatch.setattr(user_terminal, "_SPLIT_S", 1.0)
    keys, terminal = os.openpty()
    tty.setraw(terminal)
    yield keys, UserTerminal(terminal)
    os.close(terminal)
    os.close(keys)


@pytest.mark.parametrize("pieces", [(b"\x1b[D",), (b"\x1b", b"[D"), (b"\x1b[", b"C"), (b"\x1b", b"O", b"A"), (b"n",)])
def test_a_key_that_a_slow_line_splits_comes_whole(keys_and_terminal, pieces):
    keys, terminal = keys_and_terminal
    os.write(keys, pieces[0])
    later = [threading.Timer(0.05 * i, os.write, (keys, piece)) for i, piece in enumerate(pieces[1:], 1)]
    for timer in later:
        timer.start()
    assert terminal.typed(1.0) == b"".join(pieces)
    for timer in later:
        timer.join()


def test_esc_alone_is_esc(keys_and_terminal, monkeypatch):
    monkeypatch.setattr(user_terminal, "_SPLIT_S", 0.02)
    keys, terminal = keys_and_terminal
    os.write(keys, b"\x1b")
    assert terminal.typed(1.0) == b"\x1b"
    assert terminal.typed(0.0) == b""


def test_a_terminal_that_has_hung_up_is_gone_and_says_nothing():
    keys, descriptor = os.openpty()
    terminal = UserTerminal(descriptor)
    os.close(keys)
    assert terminal.typed(1.0) == b""
    assert terminal.gone and not terminal.reachable
    os.close(descriptor)


def test_the_end_of_input_is_told_as_the_key_that_means_it(keys_and_terminal):
    keys, terminal = keys_and_terminal
    tty.setcbreak(terminal.descriptor)
    mode = termios.tcgetattr(terminal.descriptor)
    mode[3] |= termios.ICANON
    termios.tcsetattr(terminal.descriptor, termios.TCSANOW, mode)
    os.write(keys, b"\x04")
    assert terminal.typed(1.0) == b"\x04" and not terminal.gone


@pytest.mark.parametrize("first", ["typed", "pressed"])
@pytest.mark.parametrize("then", ["typed", "pressed"])
def test_only_what_is_typed_behind_a_typed_esc_does_not_wait(monkeypatch, first, then):
    """What is typed behind a typed Esc comes as late as it was typed: later still it would be no sequence any more."""
    waits = []
    monkeypatch.setattr(pseudo_terminal, "_AFTER_ESC_S", 60.0)
    monkeypatch.setattr(pseudo_terminal.time, "sleep", waits.append)
    terminal = PseudoTerminal()
    terminal._write(b"\x1b", typed=first == "typed")
    terminal._write(b"[D", typed=then == "typed")
    assert bool(waits) is not (first == then == "typed")
