"""yam-setup-can on trees of three systems: what it writes, again, after an interruption, and undone."""

import json
import os
import sys
import tempfile
from pathlib import Path

import pytest

from lerobot_robot_yam.commands.setup_can import NAMES, main
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.setup.system_files import JOURNAL
from lerobot_robot_yam.state.records import channel_key, lock_path, state_path
from lerobot_robot_yam.system.runtime_files import FileLock
from tests.support.system_tree import SYSTEMS, USER, SystemTree
from tests.support.terminal import Terminal

RULES, UNIT = "etc/udev/rules.d/70-yam-can.rules", "etc/systemd/system/yam-can@.service"
PAIRS = ("can_follower_l=can0", "can_leader_l=can1")


@pytest.fixture(params=SYSTEMS)
def tree(request, tmp_path):
    """A computer with two adapters, whose serial numbers differ."""
    tree = SystemTree(tmp_path / "root", request.param)
    tree.sysfs.adapter("can0", "1-1.3", serial="0031AAAA")
    tree.sysfs.adapter("can1", "1-1.4", serial="0031BBBB")
    return tree


@pytest.fixture
def debian(tmp_path):
    """A computer without an adapter."""
    return SystemTree(tmp_path / "root", "debian")


def run(tree, *arguments):
    return main([*arguments, f"--root={tree.root}", "--yes"])


def rule(tree, name):
    """The rule that gives a name."""
    (line,) = [line for line in tree.read(RULES).splitlines() if f'NAME="{name}"' in line]
    return line


def test_names_links_and_rights_and_all_of_it_undone(tree, capsys):
    before = tree.snapshot()
    assert run(tree, *PAIRS, f"--user={USER}") == 0
    assert 'ATTRS{serial}=="0031AAAA"' in rule(tree, "can_follower_l")
    assert 'ENV{SYSTEMD_WANTS}+="yam-can@can_follower_l.service"' in rule(tree, "can_follower_l")
    assert 'ACTION!="remove"' in rule(tree, "can_follower_l")  # systemd waits for the "move" after a renaming
    assert "DEVPATH" not in rule(tree, "can_leader_l")  # it may be moved to another port
    assert "bitrate 1000000" in tree.read(UNIT) and "txqueuelen 100" in tree.read(UNIT)
    assert tree.read("etc/security/limits.d/90-yam.conf") == f"{USER} - rtprio 20\n{USER} - memlock unlimited\n"
    for path in ("etc/group", "etc/gshadow"):
        members = {line.split(":")[0]: line.split(":")[3].split(",") for line in tree.read(path).splitlines()}
        assert USER in members["video"] and USER in members["input"]
    assert (tree.root / "etc/gshadow").stat().st_mode & 0o777 == 0o640
    said = capsys.readouterr().err
    assert all(f"/{path} is new" in said for path in (RULES, UNIT))
    assert (f"/etc/group: {USER} joins the group" in said) == ("rpi-issue" not in os.listdir(tree.root / "etc"))
    assert ":!:" not in said  # where a group's password is
    changed = tree.snapshot()
    assert run(tree, *PAIRS, f"--user={USER}") == 0
    assert tree.snapshot() == changed and capsys.readouterr().err.count("nothing to change") == 2
    assert run(tree, "--undo") == 0
    assert tree.snapshot() == before
    assert run(tree, "--undo") == 0 and "nothing to undo" in capsys.readouterr().err


def test_a_dry_run_shows_it_all_and_changes_nothing(tree, capsys):
    before = tree.snapshot()
    assert run(tree, *PAIRS, f"--user={USER}", "--dry-run") == 0
    said = capsys.readouterr().err
    assert '+SUBSYSTEM=="net"' in said and "would run: udevadm control --reload" in said and "rtprio" in said
    assert "would run: systemctl restart yam-can@can_leader_l.service" in said
    assert tree.snapshot() == before
    assert run(tree, *PAIRS, f"--user={USER}") == 0
    after = tree.snapshot()
    capsys.readouterr()
    assert run(tree, "--undo", "--dry-run") == 0
    assert f"/{RULES} goes" in capsys.readouterr().err and tree.snapshot() == after


def test_one_serial_number_goes_by_port_whatever_the_bus_is_numbered(tree):
    tree.sysfs.adapter("can2", "1-2", serial="0031AAAA")
    assert run(tree, "can_follower_l=can0", "can_follower_r=can2", "can_leader_l=can1", "--no-rights") == 0
    left, right = rule(tree, "can_follower_l"), rule(tree, "can_follower_r")
    assert '/usb*/*-1.3/*-1.3:1.0/net/*"' in left and '/usb*/*-2/*-2:1.0/net/*"' in right
    assert "serial" not in left + right and "xhci-hcd.0" not in left
    assert 'ATTRS{serial}=="0031BBBB"' in rule(tree, "can_leader_l")


def test_a_twin_that_comes_later_ties_the_first_to_its_port_too(debian):
    debian.sysfs.adapter("can0", "1-1", serial="0001")
    assert run(debian, "can_follower_l=can0", "--no-rights") == 0
    assert "serial" in rule(debian, "can_follower_l")
    debian.sysfs.unplug("1-1")
    debian.sysfs.adapter("can0", "1-2", serial="0001")
    assert run(debian, "can_follower_r=can0", "--no-rights") == 0
    assert "*-1:1.0" in rule(debian, "can_follower_l") and "*-2:1.0" in rule(debian, "can_follower_r")


def test_an_adapter_that_was_moved_stays_tied_to_its_serial_number(debian):
    debian.sysfs.adapter("can0", "1-1", serial="0031AAAA")
    assert run(debian, "can_follower_l=can0", "--no-rights") == 0
    debian.sysfs.unplug("1-1")
    debian.sysfs.adapter("can_follower_l", "1-4", serial="0031AAAA")
    debian.sysfs.adapter("can0", "1-1", serial="0031BBBB")
    assert run(debian, "can_follower_r=can0", "--no-rights") == 0
    assert "0031AAAA" in rule(debian, "can_follower_l") and "0031BBBB" in rule(debian, "can_follower_r")


@pytest.mark.parametrize(
    ("second", "match"),
    [
        ({"number": "0x1"}, 'ATTR{dev_id}=="0x1"'),
        ({"dev_port": "1"}, 'ATTR{dev_port}=="1"'),
        ({"function": "1.1"}, 'DEVPATH=="*:1.1/net/*"'),
    ],
)
def test_the_channels_of_one_adapter_are_told_apart(debian, second, match):
    debian.sysfs.adapter("can0", "1-1", serial="0001")
    debian.sysfs.adapter("can1", "1-1", serial="0001", **second)
    assert run(debian, "can_follower_l=can0", "can_follower_r=can1", "--no-rights") == 0
    assert match in rule(debian, "can_follower_r") and match not in rule(debian, "can_follower_l")
    assert 'ATTRS{serial}=="0001"' in rule(debian, "can_follower_l")


def test_what_is_refused_says_why_and_changes_nothing(debian, capsys):
    debian.sysfs.adapter("can0", "1-1", serial="0001")
    debian.sysfs.adapter("can1", "1-1", serial="0001")
    debian.sysfs.adapter("can2", "1-2", serial="0002")
    debian.sysfs.adapter("can_old", "1-3", serial="0003")
    debian.write("etc/udev/rules.d/90-lab.rules", '# ours\nSUBSYSTEM=="net", KERNELS=="1-2:1.0", NAME="can_lab"\n')
    debian.write("etc/systemd/network/10-can.link", "[Match]\nPath=x\n[Link]\nName=can_link\n")
    before = debian.snapshot()
    for words, why in (
        (("can_a=can9",), "no CAN adapter 'can9'; there are: can0, can1, can2, can_old"),
        (("can_a=can0",), "does not tell can0 from can1"),
        (("can7=can2",), "is no name for an adapter"),
        (("much_too_long_name=can2",), "is no name for an adapter"),
        (("can_lab=can_old",), "taken by /etc/udev/rules.d/90-lab.rules:2"),
        (("can_a=can2",), "can2 is named can_lab by /etc/udev/rules.d/90-lab.rules:2"),
        (("can_link=can_old",), "taken by /etc/systemd/network/10-can.link:4"),
        (("can_old=can2",), "can2 is named can_lab"),
    ):
        assert run(debian, *words, "--no-rights") == 1
        assert why in capsys.readouterr().err
    assert run(debian, "can_old=can_old", f"--user={USER}x") == 1
    assert f"no user '{USER}x'" in capsys.readouterr().err
    debian.write("etc/passwd", debian.read("etc/passwd") + "*:x:1001:1001::/:/bin/sh\n-r:x:1002:1002::/:/bin/sh\n")
    for user in (f"{USER}:x", "*", "-r"):
        assert run(debian, "--rights", f"--user={user}") == 1
        assert "there is no user" in capsys.readouterr().err
    debian.write("etc/passwd", debian.read("etc/passwd").split("*:x")[0])
    assert run(debian, "--no-rights", "can_a") == 1 and "no terminal" in capsys.readouterr().err
    assert main([f"--root={debian.root}/none"]) == 1 and "is no root of a system" in capsys.readouterr().err
    assert debian.snapshot() == before
    debian.sysfs.adapter("can3", "1-4", serial="0004")
    assert run(debian, "can_old=can3", "--no-rights") == 1
    assert "taken by a network interface" in capsys.readouterr().err


def test_an_interrupted_run_goes_on_and_is_undone(debian, capsys):
    debian.sysfs.adapter("can0", "1-1", serial="0001")
    before = debian.snapshot()
    (debian.root / "etc/systemd/system").rmdir()
    debian.write("etc/systemd/system", "in the way")
    assert run(debian, "can_follower_l=can0", "--no-rights") == 1
    assert f"/{UNIT} cannot be" in capsys.readouterr().err
    (debian.root / "etc/systemd/system").unlink()
    (debian.root / "etc/systemd/system").mkdir()
    assert run(debian, "can_follower_l=can0", "--no-rights") == 0
    assert (debian.root / UNIT).exists()
    assert run(debian, "--undo") == 0
    assert debian.snapshot() == before


def test_what_others_have_changed_since_is_left(debian, capsys):
    limits, group = "etc/security/limits.d/90-yam.conf", "etc/group"
    debian.write(limits, "eve - rtprio 50\n")
    assert run(debian, "--rights", f"--user={USER}") == 0
    assert debian.read(limits).startswith("eve - rtprio 50\n")
    debian.write("etc/udev/rules.d/70-yam-devices.rules", "mine now\n")
    debian.write(group, debian.read(group) + "eve:x:1001:\n")
    assert run(debian, "--undo") == 0
    assert "70-yam-devices.rules was left as it is" in capsys.readouterr().err
    assert debian.read(limits) == "eve - rtprio 50\n"
    assert debian.read(group).endswith("eve:x:1001:\n") and f"input:x:104:{USER}" not in debian.read(group)


@pytest.mark.parametrize(
    "journal",
    [
        {"files": {"{outside}": {"before": "undone", "written": ["theirs"]}}},
        {"files": {"../outside": {"before": "undone", "written": ["theirs"]}}},
        {"files": {"etc/passwd": {"before": "", "written": []}}},
        {"files": {"etc/udev/rules.d/70-yam-can.rules": {"before": None}}},
        {"files": {"etc/udev/rules.d/70-yam-can.rules": {"before": 3, "written": [None]}}},
        {"files": []},
        {"groups": {USER: "video"}},
        {"groups": {"--root": ["video"]}},
        {"groups": {USER: [3]}},
        [],
    ],
    ids=str,
)
def test_a_journal_that_is_not_ours_is_refused_and_changes_nothing(debian, capsys, journal):
    outside = debian.root.parent / "outside"
    outside.write_text("theirs")
    debian.write(JOURNAL, json.dumps(journal).replace("{outside}", str(outside)))
    debian.sysfs.adapter("can0", "1-1", serial="0001")
    before = debian.snapshot()
    for arguments in (["--undo"], ["can_a=can0", "--no-rights"]):
        assert run(debian, *arguments) == 1
        assert f"/{JOURNAL}, what was changed, is damaged" in capsys.readouterr().err
    assert debian.snapshot() == before and outside.read_text() == "theirs"


@pytest.mark.parametrize("link", ["etc/udev/rules.d", "etc/udev/rules.d/70-yam-can.rules"])
def test_no_link_leads_out_of_the_root(debian, capsys, tmp_path, link):
    debian.sysfs.adapter("can0", "1-1", serial="0001")
    assert run(debian, "can_a=can0", "--no-rights") == 0
    (debian.root / link).rename(tmp_path / "theirs")
    (debian.root / link).symlink_to(tmp_path / "theirs")
    theirs = [path.read_text() for path in tmp_path.glob("theirs*/*") if path.is_file()]
    for arguments in (["--undo"], ["can_b=can0", "--no-rights"]):
        assert run(debian, *arguments) == 1 and "remove that link" in capsys.readouterr().err
    assert [path.read_text() for path in tmp_path.glob("theirs*/*") if path.is_file()] == theirs


def test_the_terminal_obeys_no_text_of_a_usb_device(debian, capsys):
    debian.sysfs.adapter("can0", "1-1", serial="00\x1b[2J01", product="can\x1b]0;x\x07dle")
    assert run(debian, "--list") == 0 and run(debian, "can_a=can0", "--no-rights") == 0
    said = capsys.readouterr()
    assert "00?[2J01" in said.out and "can?]0;x?dle" in said.out
    assert "\x1b" not in said.out + said.err + debian.read(RULES) and "*-1:1.0" in rule(debian, "can_a")


def test_a_reset_takes_links_down_and_up_but_not_under_a_session(debian, capsys):
    debian.sysfs.adapter("can0", "1-1", serial="0001")
    debian.sysfs.adapter("can1", "1-2", kernel_driver="peak_usb")
    assert run(debian, "--reset") == 0
    said = capsys.readouterr().err
    assert "ip link set can0 down" in said and "can0 type can restart-ms" not in said  # gs_usb cannot
    assert "ip link set can1 type can restart-ms 100" in said
    assert "ip link set can1 up txqueuelen 100 type can bitrate 1000000" in said
    key = channel_key("socketcan", "can1", None)
    state_path(key).touch()
    try:
        with FileLock(lock_path(key), "can1"):
            assert run(debian, "--reset", "can1") == 1
            assert f"can1 is used by process {os.getpid()}" in capsys.readouterr().err
            assert run(debian, "can_x=can1", "--no-rights") == 1
    finally:
        state_path(key).unlink()
    with FileLock(lock_path(key), "can1"):  # yam-motors console energises a motor, and publishes no state
        assert run(debian, "--reset", "can1") == 1
    assert not (debian.root / RULES).exists()
    assert run(debian, "--reset", "can1") == 0


def test_without_rights_it_says_so_before_it_asks(capsys):
    with tempfile.TemporaryDirectory(dir="/dev/shm") as directory:  # pytest's own is closed to others
        os.chmod(directory, 0o755)
        tree = SystemTree(Path(directory, "root"), "debian")
        (tree.root / "etc").chmod(0o555)
        root = os.geteuid() == 0
        if root:
            os.seteuid(65534)
        try:
            assert run(tree, "--no-rights") == 1
        finally:
            if root:
                os.seteuid(0)
        (tree.root / "etc").chmod(0o755)
    said = capsys.readouterr().err
    assert "no right to write" in said and "sudo" in said and "--dry-run" in said


@pytest.mark.long
def test_at_a_terminal_adapters_are_plugged_in_one_after_another(debian, tmp_path):
    """Interrupted after the second name; run again it asks for the others only."""
    program = (sys.executable, "-m", "lerobot_robot_yam.commands.setup_can", f"--root={debian.root}", "--no-rights")
    debian.sysfs.adapter("can0", "1-4", serial="0031CCCC")  # plugged in before
    with Terminal(tmp_path, *program) as terminal:
        terminal.wait_shown("can_follower_l: plug in its adapter")
        debian.sysfs.adapter("can1", "1-1", serial="0001")
        terminal.answer(("Make these changes?", b"n\n"), ("nothing was changed", b""))
        assert not (debian.root / RULES).exists()
        terminal.answer(("", b"can1\n\n"), ("can_follower_r: plug in its adapter", b""))
        debian.sysfs.unplug("1-4")
        debian.sysfs.adapter("can0", "1-2", serial="0001")
        debian.sysfs.adapter("can2", "1-3", serial="0031DDDD")
        terminal.wait_shown("several came at once")
        debian.sysfs.unplug("1-2")
        debian.sysfs.unplug("1-3")
        terminal.type(b"can7\n")
        terminal.wait_shown("no CAN adapter 'can7'; there are: can1\r\n\r\ncan_follower_r: plug in its adapter")
        debian.sysfs.adapter("can0", "1-2", serial="0001")
        terminal.answer(('*-2:1.0/net/*"', b"y\n"), ("can_leader_l: plug in its adapter", b"\x03"))
        assert terminal.end() == 130
    assert "*-1:1.0" in rule(debian, "can_follower_l") and "*-2:1.0" in rule(debian, "can_follower_r")
    debian.sysfs.adapter("can2", "1-4", serial="0031CCCC")
    with Terminal(tmp_path, *program) as terminal:
        terminal.answer(("can_follower_r is tied already", b""), ("can_leader_l: plug in its adapter", b""))
        debian.sysfs.unplug("1-4")
        terminal.answer(("", b"\n"), ("can_leader_r: plug in its adapter", b""))
        debian.sysfs.adapter("can2", "1-4", serial="0031CCCC")
        debian.sysfs.adapter("can3", "1-4", serial="0031CCCC", number="0x1")
        terminal.answer(("Which one is for can_leader_r?", b"can3\n"), ("Make these changes?", b"\n"))
        assert terminal.end() == 0
    assert 'ATTR{dev_id}=="0x1"' in rule(debian, "can_leader_r") and NAMES[2] not in debian.read(RULES)


def test_an_arm_is_found_by_its_wrist_and_stays_limp(debian, tmp_path):
    debian.sysfs.adapter("leader_left", "1-1", serial="0001")
    debian.sysfs.adapter("leader_right", "1-2", serial="0002")
    with running_rig(arms=["leader_left", "leader_right"]) as rig:
        options = (f"--root={debian.root}", f"--rig={rig.name}", "--wrist", "--no-rights", "can_leader_r")
        with Terminal(tmp_path, sys.executable, "-m", "lerobot_robot_yam.commands.setup_can", *options) as terminal:
            terminal.wait_shown("can_leader_r: turn its wrist by hand")
            q = rig.state()["arms"]["leader_right"]["q"]
            rig.lift("leader_right", [*q[:-1], q[-1] + 0.8], then_release=True)
            terminal.answer(("leader_right it is", b""), ("Make these changes?", b"\n"))
            assert terminal.end() == 0
        assert not [event for event in rig.events() if event["kind"] == "motor_enabled"]
    assert "0002" in rule(debian, "can_leader_r")
