"""The system's tools are run in their order, and say what went wrong; the unit is as systemd reads it."""

import shutil
import subprocess
from pathlib import Path

import pytest

from lerobot_robot_yam.doctor.check_link import NO_RESTART
from lerobot_robot_yam.errors import SetupError
from lerobot_robot_yam.setup.system_files import FileChange, GroupChange, SystemFiles
from lerobot_robot_yam.setup.system_tools import UNIT, UNIT_TEXT, SystemTools, bring_up
from lerobot_robot_yam.system.sysfs import CanAdapter, read_adapters
from tests.support.doctor_desk import Sysfs

ADAPTER = CanAdapter("can9", "gs_usb", None, None, None, None, None)


@pytest.fixture
def ran(tmp_path, monkeypatch):
    """The commands that were run; no other tool can be found."""
    for tool in ("ip", "udevadm", "systemctl"):
        (tmp_path / tool).write_text(f'#!/bin/sh\necho "{tool} $*" >> {tmp_path}/ran\n')
        (tmp_path / tool).chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    (tmp_path / "ran").touch()
    return lambda: (tmp_path / "ran").read_text().splitlines()


@pytest.fixture
def tools(ran):
    said = []
    return SystemTools(SystemFiles(Path("/")), said.append, dry=False)


class ThisComputer(SystemFiles):
    """A directory whose files stand for those of this computer."""

    live = True


def test_an_adapter_is_renamed_while_its_link_is_down_then_brought_up(ran, tmp_path):
    net = tmp_path / "sys/class/net"
    for index, name in enumerate(("can8", "can9", "can_a")):
        (net / name).mkdir(parents=True)
        (net / name / "ifindex").write_text(f"{index}\n")
    given = f"{net}/$(/bin/cat {tmp_path}/rule)"  # as udev: not when another interface has the name
    with (tmp_path / "udevadm").open("a") as tool:
        tool.write(f'[ "$1" != trigger ] || [ -e {given} ] || /bin/mv {net}/${{3##*/}} {given}\n')
    tools = SystemTools(ThisComputer(tmp_path), list[str]().append, dry=False)

    def renamed(interface, name):
        before = len(ran())
        (tmp_path / "rule").write_text(name)
        done = tools.rename(interface, name)
        first = [f"ip link set {interface} down", f"udevadm trigger --action=add /sys/class/net/{interface}"]
        assert ran()[before:][:3] == [*first, "udevadm settle"]
        return done, ran()[before:][3:]

    assert renamed("can9", "can_b") == (True, ["systemctl restart yam-can@can_b.service"])
    assert renamed("can8", "can_a") == (False, [])  # another adapter's, as when two swap their names


def test_only_groups_that_were_joined_are_left_again(tmp_path):
    (tmp_path / "etc").mkdir()
    (tmp_path / "etc/group").write_text("dialout:x:20:eva\nvideo:x:44:eva\nplugdev:x:46:\n")
    files = SystemFiles(tmp_path)
    for groups in (("dialout",), ("dialout", "plugdev")):
        files.apply([GroupChange("eva", groups)])
    assert files.undo_changes() == ([GroupChange("eva", ("dialout",), joins=False)], [])


def test_a_reset_and_a_new_unit(tools, ran):
    tools.reset(ADAPTER)
    tools.load([FileChange(UNIT, None, "x")])
    up = "ip link set can9 up txqueuelen 100 type can bitrate 1000000"
    assert ran() == ["ip link set can9 down", up, "systemctl daemon-reload"]


def test_a_tool_that_fails_or_is_missing(tools, tmp_path):
    (tmp_path / "ip").write_text("#!/bin/sh\necho RTNETLINK answers: Operation not permitted >&2\nexit 2\n")
    with pytest.raises(SetupError, match="ip link set can9 down failed: RTNETLINK answers: Operation not permitted"):
        tools.reset(ADAPTER)
    (tmp_path / "ip").unlink()
    with pytest.raises(SetupError, match="ip link set can9 down failed: .*No such file"):
        tools.reset(ADAPTER)


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")
def test_systemd_takes_the_unit(tmp_path):
    unit = tmp_path / "yam-can@can_follower_l.service"
    unit.write_text(UNIT_TEXT)
    done = subprocess.run(["systemd-analyze", "verify", unit], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    unit.write_text(UNIT_TEXT.replace("Type=oneshot", "Type=nothing"))
    assert subprocess.run(["systemd-analyze", "verify", unit], capture_output=True, timeout=60).stderr


@pytest.mark.parametrize("driver", ["gs_usb", "peak_usb"])
def test_by_hand_a_link_gets_what_the_unit_gives_it(tmp_path, driver):
    sysfs = Sysfs(tmp_path)
    sysfs.adapter("can_x", "1-1", kernel_driver=driver)
    commands = [" ".join(command) for command in bring_up(*read_adapters(tmp_path))]
    unit = UNIT_TEXT.replace("%i", "can_x")
    assert all(command in unit for command in commands)
    assert len(commands) == (2 if driver in NO_RESTART else 3)
