"""yam-host: what it refuses, makes and says; and commands of this package that look at its arms with --host."""

import json
import stat
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from lerobot_robot_yam.commands.doctor import main as yam_doctor
from lerobot_robot_yam.commands.identify import main as yam_identify
from lerobot_robot_yam.commands.servers.host import groups_of, main
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.remote.client.host_question import Host
from lerobot_robot_yam.remote.client.host_watch import watched
from lerobot_robot_yam.rig.client.rig_control import running_rig
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import STATE_DTYPE, ArmState, state_path
from lerobot_robot_yam.system.runtime_files import runtime_dir, sessions
from lerobot_robot_yam.system.shared_block import SharedBlock
from tests.support.hosted import ServedArms, free_port, rig_file, running_host

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
    assert (teleop.role, teleop.device, [arm.number for arm in teleop.arms]) == ("teleop", "bi_yam_leader", [2, 3])
    told = teleop.told()["arms"]["left_"]["options"]
    assert told["follower"] == ARM and told["gate"] == "auto" and told["name"] == "left_leader"
    json.dumps([robot.told(), teleop.told()])


@pytest.mark.long
def test_leaders_without_motors_are_refused(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text("teleop: {type: yam_passive_leader, channel: can9}\n")
    with pytest.raises(ConfigError, match="no yam_passive_leader"):
        groups_of(path)


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
def test_watching_shows_the_arms_that_run_and_nothing_else():
    with running_rig(arms=[ARM]) as rig, ServedArms(rig, ARM) as served:
        key = served.address.key(ARM)
        with watched(Host(served.address)):
            assert not state_path(key).is_symlink()  # nothing runs
        (group,) = served.groups
        session = served.session()
        session.start()
        session.stop()
        answers = []
        group.start(5, "a test", True, answers.append)
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
