"""The pseudo-terminal under LeRobot's own listener: typed keys arrive, and the user's terminal stays what it was."""

import os
import signal
import subprocess
import sys
import time

import pytest
from lerobot.utils.keyboard_input import init_keyboard_listener

from lerobot_robot_yam.face.operator_keys.pseudo_terminal import PseudoTerminal
from tests.support.paths import ROOT
from tests.support.terminal import Terminal

PROGRAM = ("-m", "tests.support.listening")
CBREAK = (False, False)
LONG = pytest.mark.long


@pytest.fixture
def listening(tmp_path):
    """Starts the program in a terminal; it listens."""
    opened = []

    def start(how, mode="sane"):
        terminal = Terminal(tmp_path, sys.executable, *PROGRAM, how, cwd=ROOT, mode=mode)
        opened.append(terminal)
        terminal.wait_shown("listens True")
        deadline = time.monotonic() + 5.0
        while terminal.echoes != CBREAK:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        return terminal

    yield start
    for terminal in opened:
        terminal.close()


@pytest.mark.parametrize("how", ["return", pytest.param("raise", marks=LONG)])
def test_typing_works_and_the_terminal_is_as_it_was(listening, how):
    terminal = listening(how)
    terminal.type(b"\x1b[C")
    terminal.wait_shown("flag exit_early")
    terminal.type(b"r")
    terminal.wait_shown("flag rerecord_episode")
    terminal.type(b"\x1b")
    assert terminal.end() == (1 if how == "raise" else 0)
    assert "[C" not in terminal.shown  # no echo
    before, after = terminal.modes()
    assert before == after


@pytest.mark.parametrize(
    "number", [signal.SIGKILL, *(pytest.param(n, marks=LONG) for n in (signal.SIGTERM, signal.SIGHUP))]
)
def test_a_signal_leaves_the_terminal_as_it_was(listening, number):
    terminal = listening("signal")
    terminal.kill(number)
    assert terminal.end() == 128 + number
    before, after = terminal.modes()
    assert before == after


def test_ctrl_c_ends_the_program_and_leaves_the_terminal_as_it_was(listening):
    terminal = listening("signal")
    terminal.type(b"\x03")
    assert terminal.end() == 128 + signal.SIGINT
    assert "KeyboardInterrupt" in terminal.shown
    before, after = terminal.modes()
    assert before == after


@pytest.mark.parametrize("mode", ["-icanon -isig -ixon", pytest.param("-echo eof ^A", marks=LONG)])
def test_a_terminal_in_another_mode_stays_in_that(listening, mode):
    terminal = listening("return", mode)
    terminal.type(b"n")
    terminal.wait_shown("flag exit_early")
    terminal.kill(signal.SIGKILL)
    terminal.end()
    before, after = terminal.modes()
    assert before == after and mode.split()[0] in before


@pytest.mark.long
def test_a_program_in_the_background_of_a_shell_is_not_stopped(tmp_path):
    program = (
        "import os, time; os.setpgid(0, 0); from lerobot_robot_yam.face.operator_keys.pseudo_terminal import "
        "pseudo_terminal; from lerobot.utils.keyboard_input import init_keyboard_listener; t = pseudo_terminal();"
        "t.take(); listener, events = init_keyboard_listener(); t.press('right'); time.sleep(1.0);"
        "print(events); t.give_back(); listener.stop()"
    )
    terminal = Terminal(tmp_path, sys.executable, "-c", program, cwd=ROOT)
    try:
        terminal.type(b"q")
        assert terminal.end() == 0
        assert "'exit_early': True" in terminal.shown and "'stop_recording': False" in terminal.shown
        before, after = terminal.modes()
        assert before == after
    finally:
        terminal.close()


def test_a_program_that_is_suspended_and_goes_on_listens_again(tmp_path):
    shell = 'set -m; "$@"; stty sane; echo suspended; fg'  # a shell with jobs, which sets its own mode meanwhile
    terminal = Terminal(tmp_path, "bash", "-c", shell, "bash", sys.executable, *PROGRAM, "return", cwd=ROOT)
    try:
        terminal.wait_shown("listens True")
        terminal.type(b"n")
        terminal.wait_shown("flag exit_early")
        terminal.type(b"\x1a")
        terminal.wait_shown("suspended")
        deadline = time.monotonic() + 5.0
        while terminal.echoes != CBREAK:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        terminal.type(b"r")
        terminal.wait_shown("flag rerecord_episode")
        terminal.type(b"\x1b")
        assert terminal.end() == 0
        before, after = terminal.modes()
        assert before == after
    finally:
        terminal.close()


def test_a_killed_program_without_a_guard_would_leave_it_in_another_mode(tmp_path):
    program = "import sys, time, tty; tty.setcbreak(0); print('set', flush=True); time.sleep(60)"
    terminal = Terminal(tmp_path, sys.executable, "-c", program)
    try:
        terminal.wait_shown("set")
        terminal.kill(signal.SIGKILL)
        terminal.end()
        before, after = terminal.modes()
        assert before != after
    finally:
        terminal.close()


def test_lines_are_read_as_before_while_nobody_listens(tmp_path):
    program = (
        "from lerobot_robot_yam.face.operator_keys.pseudo_terminal import pseudo_terminal as p; p().take();"
        "print('ready', flush=True); print('got', input('say: '), flush=True); print('got', input(), flush=True)"
    )
    terminal = Terminal(tmp_path, sys.executable, "-c", program, cwd=ROOT)
    try:
        terminal.wait_shown("ready")
        terminal.type(b"helo\x7flo\n")
        terminal.wait_shown("got hello")
        terminal.type(b"\x04")
        assert terminal.end() == 1
        assert "EOFError" in terminal.shown
    finally:
        terminal.close()


@pytest.mark.parametrize("given", ["closed", *(pytest.param(g, marks=LONG) for g in ("file", "null", "pipe"))])
def test_without_a_terminal_pressed_keys_arrive_and_nothing_is_read(given, tmp_path):
    program = (
        "import sys, time; from lerobot_robot_yam.face.operator_keys.pseudo_terminal import pseudo_terminal as p;"
        "before = sys.stdin; t = p(); t.take(); from lerobot.utils.keyboard_input import init_keyboard_listener as i;"
        "listener, events = i(); t.press('right'); time.sleep(0.5); print(events); t.give_back(); listener.stop();"
        "assert sys.stdin is before; print('rest', before.read() if before else None)"
    )
    jobs = tmp_path / "jobs.txt"
    jobs.write_text("q\nr\n")
    command = [sys.executable, "-c", program]
    if given == "closed":
        command = ["sh", "-c", 'exec "$@" <&-', "sh", *command]
    stdin = {"null": subprocess.DEVNULL, "pipe": subprocess.PIPE, "closed": None}.get(given)
    with open(jobs) as file:
        process = subprocess.Popen(
            command,
            cwd=ROOT,
            stdin=file if given == "file" else stdin,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        said, _ = process.communicate("q\nr\n" if given == "pipe" else None, timeout=60)
    assert process.returncode == 0, said
    assert "'exit_early': True" in said and "'stop_recording': False" in said and "'rerecord_episode': False" in said
    rest = {"null": "rest ", "closed": "rest None"}.get(given, "rest q\nr\n")
    assert said.strip().endswith(rest.strip())


def test_a_key_behind_esc_is_a_key_of_its_own(monkeypatch):
    terminal = PseudoTerminal()
    with open(os.devnull) as nothing:
        monkeypatch.setattr(sys, "stdin", nothing)
        terminal.take()
        listener, events = init_keyboard_listener()
        try:
            for key in ("esc", "left", "esc", "right"):
                terminal.press(key)
            deadline = time.monotonic() + 2.0
            while not all(events.values()):
                assert time.monotonic() < deadline, events
                time.sleep(0.01)
        finally:
            listener.stop()
            terminal.give_back()
        assert sys.stdin is nothing
