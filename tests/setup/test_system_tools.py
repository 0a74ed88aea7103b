"""The system's tools are run in their order, and say what went wrong. Recorders stand in PATH for them."""

from pathlib import Path

import pytest

from lerobot_robot_yam.errors import SetupError
from lerobot_robot_yam.setup.link_unit import UNIT
from lerobot_robot_yam.setup.system_files import FileChange, SystemFiles
from lerobot_robot_yam.setup.system_tools import SystemTools
from lerobot_robot_yam.system.sysfs import CanAdapter

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
