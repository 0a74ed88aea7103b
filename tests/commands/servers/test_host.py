"""yam-host: what it refuses, makes and says; and commands of this package that look at its arms with --host."""

import contextlib
import json
import os
import socket
import stat
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from lerobot_robot_yam.commands.doctor import main as yam_doctor
from lerobot_robot_yam.commands.identify import main as yam_identify
from lerobot_robot_yam.commands.servers.host import groups_of, main
from lerobot_robot_yam.remote.host_question import Host
from lerobot_robot_yam.remote.host_watch import watched, watched_key
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.state.arm_state import ArmState
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import STATE_DTYPE, state_path
from lerobot_robot_yam.system.runtime_dirs import sessions
from lerobot_robot_yam.system.runtime_files import runtime_dir
from lerobot_robot_yam.system.shared_block import SharedBlock
from tests.support.hosted import HostProcess, ServedArms, free_port, rig_file, running_host

ARM = "follower_left"


def test_a_pair_of_keys_is_made(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["pair", "workstation", "--keys", str(tmp_path / "keys")]) == 0
    made = tmp_path / "workstation.yam-key.json"
    assert stat.S_IMODE(made.stat().st_mode) == 0o600 and f"--robot.key={made.name}" in capsys.readouterr().err
    assert main(["pair", "workstation", "--keys", str(tmp_path / "keys")]) == 1
    assert main(["pair", "--keys", str(tmp_path / "keys")]) == 1
    assert "which computer?" in capsys.readouterr().err


def test_it_says_what_it_needs(tmp_path, capsys):
    assert main([]) == 1
    assert "--config_path=rig.yaml" in capsys.readouterr().err
    assert main(["--config_path", str(tmp_path / "no.yaml")]) == 1
    assert "yam-setup writes it" in capsys.readouterr().err


@pytest.mark.long
def test_status_without_a_host(tmp_path, capsys):
    assert main(["status", "--listen", f"127.0.0.1:{free_port()}", "--keys", str(tmp_path)]) == 1
    said = capsys.readouterr()
    assert said.out == "paired: none\n" and "no yam-host answers" in said.err


def test_groups_are_those_of_the_file(tmp_path):
    robot, teleop = groups_of(rig_file(tmp_path, SimpleNamespace(name="a-rig"), gate="auto"))
    assert (robot.role, robot.device, robot.prefixes) == ("robot", "bi_yam_follower", ["left_", "right_"])
    assert (teleop.role, teleop.device, [arm.number for arm in teleop.parts]) == ("teleop", "bi_yam_leader", [2, 3])
    told = teleop.told()["parts"]["left_"]["options"]
    assert told["follower"] == ARM and told["gate"] == "auto" and told["name"] == "left_leader"
    json.dumps([robot.told(), teleop.told()])


@pytest.mark.long
def test_commands_look_at_the_arms_of_a_host(tmp_path, capsys):
    with running_rig(arms=[ARM]) as rig, running_host(rig_file(tmp_path, rig, arms=[ARM]), tmp_path) as host:
        assert "torch" not in Path(f"/proc/{host.process.pid}/maps").read_text()  # 700 MB of a small computer
        there = ["--host", str(host.address)]
        assert main(["status", "--listen", str(host.address), "--keys", str(tmp_path)]) == 0
        assert f"robot (rig-{rig.name.partition('-')[2]}.{ARM}): free" in capsys.readouterr().out
        assert yam_identify(["--channel", ARM, "--json", *there]) == 0
        assert json.loads(capsys.readouterr().out)["channel"] == ARM
        assert yam_identify(["--channel", "can9", *there]) == 2
        assert f"its channels are {ARM}" in capsys.readouterr().err
        assert yam_doctor(["--json", *there]) in (0, 1)
        assert ARM in capsys.readouterr().out


@pytest.mark.long
def test_status_asks_the_host_that_runs_here(tmp_path, capsys):
    """It listens elsewhere than by default, and has keys: it is told neither."""
    assert main(["pair", "workstation", f"--keys={tmp_path / 'keys'}", f"--out={tmp_path / 'key.json'}"]) == 0
    file = rig_file(tmp_path, SimpleNamespace(name="a-rig"), arms=[ARM])
    host = HostProcess(file, tmp_path)
    try:
        deadline = time.monotonic() + 60.0
        while main(["status", f"--keys={tmp_path}"]) != 0:  # the running host says which keys it has
            assert time.monotonic() < deadline and host.process.poll() is None, host.said()
        said = capsys.readouterr().out
        assert said.count(": free\n") == 1, said
    finally:
        host.end()


@pytest.mark.long
def test_a_host_answers_while_its_terminal_is_on_hold(tmp_path):
    """What it does it also logs: here that an emergency stop was latched."""
    os.mkfifo(tmp_path / "host.txt")
    terminal = os.open(tmp_path / "host.txt", os.O_RDONLY | os.O_NONBLOCK)
    keyboard = os.open(tmp_path / "host.txt", os.O_WRONLY | os.O_NONBLOCK)
    host = HostProcess(rig_file(tmp_path, SimpleNamespace(name="a-rig"), arms=[ARM]), tmp_path)
    try:
        host.wait()
        with contextlib.suppress(BlockingIOError):
            while os.write(keyboard, b"."):
                pass
        asked = {"who": "a test", "why": "a test"}
        assert Host(host.address).ask("estop", action="latch", **asked)["latched"]
        assert not Host(host.address).ask("estop", action="release", **asked)["latched"]
    finally:
        os.close(terminal)
        os.close(keyboard)
        EmergencyStop().release()
        host.end()


@pytest.mark.long
def test_a_connection_that_never_greets_is_closed(tmp_path):
    file = rig_file(tmp_path, SimpleNamespace(name="a-rig"), arms=[ARM])
    with running_host(file, tmp_path) as host:
        with socket.create_connection((host.address.host, host.address.port), 10.0) as silent:
            while silent.recv(64):  # its own greeting, then the end
                pass
        limits = Path(f"/proc/{host.process.pid}/limits").read_text().splitlines()
        soft, hard = next(line for line in limits if line.startswith("Max open files")).split()[3:5]
        assert soft == hard


@pytest.mark.long
def test_watching_shows_the_arms_that_run_and_nothing_else():
    with running_rig(arms=[ARM]) as rig, ServedArms(rig, ARM) as served:
        driven_as = served.address.key(ARM)
        key = watched_key(driven_as)
        session = served.session()
        with watched(Host(served.address)):
            assert not state_path(key).is_symlink()  # nothing runs
            session.start()
            assert driven_as in sessions(runtime_dir())
            time.sleep(0.5)
            assert key not in sessions(runtime_dir())
            session.stop()
        (group,) = served.groups
        group.start(5, "a test", True)
        deadline = time.monotonic() + 20.0
        with watched(Host(served.address)):
            while not state_path(key).exists():
                assert time.monotonic() < deadline
                time.sleep(0.01)
            assert key in sessions(runtime_dir())
            block = SharedBlock(state_path(key), STATE_DTYPE, create=False)
            while ArmState(block.read_bytes()).mode is not Mode.HOLD:
                assert time.monotonic() < deadline
                time.sleep(0.01)
            block.close()
        assert key not in sessions(runtime_dir())
