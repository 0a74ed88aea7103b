"""yam-waldo: it serves scripts and starts Commander beside it; only `arm`, confirmed, energises."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time

import pytest

from lerobot_robot_yam.commands.pages.waldo import hazard, main
from lerobot_robot_yam.waldo.wire import ask_once
from tests.support.paths import ROOT

HOST = "127.0.0.1"
_COMMANDER = """#!/bin/sh
echo "$WALDO_ROBOT $WALDO_EXCLUSIVE_START $YAM_WALDO_ARM $*" > "$SEEN"
exec sleep 60
"""


def free_port():
    with socket.socket() as taken:
        taken.bind((HOST, 0))
        return taken.getsockname()[1]


@contextlib.contextmanager
def served(*arguments, **variables):
    """`yam-waldo` as a process, once it answers; its port, and the process."""
    port = free_port()
    command = [sys.executable, "-m", "lerobot_robot_yam.commands.pages.waldo", "--port", str(port), *arguments]
    with subprocess.Popen(command, cwd=ROOT, env={**os.environ, **variables}, stderr=subprocess.PIPE) as process:
        try:
            deadline = time.monotonic() + 30.0
            while ask_once(HOST, port, "ping") is None and process.poll() is None and time.monotonic() < deadline:
                time.sleep(0.05)
            yield port, process
        finally:
            process.terminate()
            process.wait(20.0)


def ended(process):
    """(exit status, what it has said) after Ctrl-C."""
    process.send_signal(signal.SIGINT)
    return process.wait(20.0), process.stderr.read().decode()


def test_it_starts_commander_attached_to_its_controller_and_ends_both(tmp_path):
    commander, seen = tmp_path / "waldo-commander", tmp_path / "seen"
    commander.write_text(_COMMANDER)
    commander.chmod(0o755)
    path = f"{tmp_path}:{os.environ['PATH']}"
    with served("--arm", "yam_pro", PATH=path, SEEN=str(seen)) as (port, process):
        assert ask_once(HOST, port, "ping")["arm"] == "yam_pro"
        deadline = time.monotonic() + 5.0
        while not (seen.exists() and seen.read_text()) and time.monotonic() < deadline:
            time.sleep(0.02)
        assert seen.read_text() == "yam 0 yam_pro --host 127.0.0.1\n"
        status, said = ended(process)
    assert status == 0 and "serving a simulated arm" in said
    assert ask_once(HOST, port, "ping") is None


@pytest.mark.long
def test_whoever_opens_it_to_the_network_is_told():
    with served("--no-page", "--host", "0.0.0.0") as (_, process):
        status, said = ended(process)
    assert status == 0 and "HAZARD: everybody on the network can move this arm" in said


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["--hardware"], "--hardware needs --channel, such as can_follower_l; nothing was started"),
        (["arm", "--yes"], "no controller of yours serves port"),
        (["arm"], "there is no terminal to confirm at"),
        (["land"], "no controller of yours serves port"),
    ],
)
def test_what_cannot_be_done_is_said_in_a_line(capsys, arguments, words):
    assert main([*arguments, "--port", str(free_port())]) == 1
    assert words in capsys.readouterr().err


def test_a_controller_of_a_simulated_arm_cannot_be_armed(capsys):
    with served("--no-page") as (port, _):
        assert main(["arm", "--yes", "--port", str(port)]) == 1
        assert "only a simulated arm: start it with --hardware" in capsys.readouterr().err


def test_the_hazard_names_channel_page_and_gripper():
    for seeks in (False, True):
        text = hazard("can7", seeks)
        assert "the arm on can7" in text and "e-stop is software" in text and ("to find its stops" in text) == seeks
