"""Seeded defects of the computer: interfaces, adapters, tools."""

import can

from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.rig.client.sim_bus import YamSimBus
from lerobot_robot_yam.system.own_commands import as_root
from tests.support.doctor_desk import FOLLOWER, LEADER, LEADER_ARM, Sysfs, examine, found, replay_tools

RESET = as_root("yam-setup-can --reset can_follower_l")


def test_an_interface_in_a_bad_state_is_not_asked(tmp_path, monkeypatch, capsys):
    """Which states are bad, test_check_link shows."""
    replay_tools(tmp_path, monkeypatch, "no_buffer")
    for arguments in ([], ["--channel=can_follower_l"]):
        status, report = examine(capsys, *arguments, f"--sysfs={tmp_path}")
        assert status == 1
        (problem,) = found(report, "problem", "can_follower_l")
        assert "no buffer space" in problem["what"] and problem["remedy"] == RESET
        assert report["channels"][0]["examined"] == "not asked: its interface is not usable"


def test_a_computer_with_two_arms(rig, tmp_path, monkeypatch, capsys):
    """Nothing is said on the command line. The rig stands behind the interfaces that the tools show."""
    rename = {"can_follower_l": FOLLOWER, "can_leader_l": LEADER}
    replay_tools(tmp_path, monkeypatch, "healthy", rename)
    monkeypatch.setitem(can.interfaces.BACKENDS, "socketcan", (YamSimBus.__module__, YamSimBus.__name__))
    monkeypatch.setenv("YAM_RIG", rig.name)
    sysfs = Sysfs(tmp_path / "sys")
    sysfs.adapter(FOLLOWER, "1-2.1", serial="0001")
    sysfs.adapter(LEADER, "1-2.2", serial="0002")
    sysfs.realsense("video0", "2-1", "5000")
    status, report = examine(capsys, f"--sysfs={sysfs.root}", "--samples=1")
    assert status == 0, report["findings"]
    assert [row["state"] for row in report["interfaces"]] == ["ERROR-ACTIVE"] * 2
    assert [row["gripper"] for row in report["channels"]] == ["linear_4310", "yam_teaching_handle"]
    assert len(found(report, "note", "_left", "its arm was not named")) == 2
    status, report = examine(capsys, f"--sysfs={sysfs.root}", f"--channel={LEADER_ARM}", "--samples=1")
    assert status == 0 and not found(report, "note", LEADER)
    rig.fault(FOLLOWER, "joint_1", "register", 1, register=int(Register.TIMEOUT))
    try:
        status, report = examine(capsys, f"--sysfs={sysfs.root}", f"--channel={FOLLOWER}", "--samples=1")
    finally:
        rig.fault(FOLLOWER, "joint_1", "register", 8000, register=int(Register.TIMEOUT))
    (problem,) = found(report, "problem", "joint_1")
    assert problem["remedy"] == (
        f"yam-motors timeout --channel {FOLLOWER} --motor 1 0.4"
        " (then switch the power off and on: until then the motor may go by the old value)"
    )


def test_an_interface_that_is_not_there(tmp_path, monkeypatch, capsys):
    replay_tools(tmp_path, monkeypatch, "down")
    status, report = examine(capsys, "--channel=can_other", f"--sysfs={tmp_path}")
    assert status == 1 and report["channels"] == []
    (problem,) = found(report, "problem", "can_other", "there is no such interface")
    assert "the system shows can_follower_l" in problem["remedy"]


def test_adapters_with_one_serial_number_and_a_camera_on_usb_2(tmp_path, monkeypatch, capsys):
    replay_tools(tmp_path, monkeypatch, "generic_names")
    sysfs = Sysfs(tmp_path / "sys")
    sysfs.adapter("can0", "1-2.1", serial="0001")
    sysfs.adapter("can1", "1-2.2", serial="0001")
    sysfs.realsense("video0", "1-3", "480")
    status, report = examine(capsys, f"--sysfs={sysfs.root}", "--samples=0")
    assert status == 1
    for name in ("can0", "can1"):
        (problem,) = found(report, "problem", name, "same serial number (0001)")
        assert "yam-setup-can" in problem["remedy"]
    assert found(report, "problem", "RealSense", "480 Mbit/s")


def test_a_computer_without_can(tmp_path, monkeypatch, capsys):
    for tool in ("ip", "tc"):
        (tmp_path / tool).write_text("#!/bin/sh\necho '[{},{}]'\n")
        (tmp_path / tool).chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    status, report = examine(capsys, f"--sysfs={tmp_path}")
    assert status == 1
    assert found(report, "problem", "this computer", "no CAN interface")


def test_a_computer_without_the_tools(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("PATH", str(tmp_path))
    _, report = examine(capsys, f"--sysfs={tmp_path}")
    (warning,) = found(report, "warning", "this computer", "state of the CAN interfaces is unknown")
    assert warning["remedy"] == "sudo apt install iproute2"
