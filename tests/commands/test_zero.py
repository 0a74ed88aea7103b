"""yam-zero on the rig: limp motors take their angle as zero, those alone, and only when nothing speaks against it."""

import json
import os
import pty
import re
import subprocess
import sys
import threading
import time

import can
import numpy as np
import pytest

from lerobot_robot_yam.arm.joint_map import TURN
from lerobot_robot_yam.arm.profile_files import ARMS, load_arm
from lerobot_robot_yam.commands.zero import main
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.errors import MotorError
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.session.yam_arm import YamArm
from tests.support.crooked_arm import OFFSETS, arguments, config, events, motor_rad, scene, sent


def test_all_joints_are_zeroed_where_they_are_and_the_gripper_is_not(crooked, capsys):
    before = motor_rad(crooked)
    crooked.trace_start("only")
    assert main(arguments(crooked, "--yes")) == 0
    after = motor_rad(crooked)
    assert max(abs(after[f"joint_{i}"]) for i in range(1, 7)) < 0.005
    assert after["gripper"] == pytest.approx(before["gripper"], abs=0.001)
    assert sent(crooked) == [1, 2, 3, 4, 5, 6]  # one frame to each, none to the gripper
    assert not events(crooked, "motor_enabled")
    said = capsys.readouterr()
    assert "HAZARD" in said.err and "zeroed and read back" in said.out
    assert "joint_1 by -0.30" in said.err  # what the change amounts to


def test_only_the_chosen_joints_are_zeroed(crooked, capsys):
    before = motor_rad(crooked)
    crooked.trace_start("only")
    assert main(arguments(crooked, "--joint", "joint_5", "joint_2", "--yes", "--json")) == 0
    after = motor_rad(crooked)
    assert sent(crooked) == [2, 5]
    for name in before:
        wanted = 0.0 if name in ("joint_2", "joint_5") else before[name]
        assert after[name] == pytest.approx(wanted, abs=0.005), name
    result = json.loads(capsys.readouterr().out)["motors"]
    assert [name for name, motor in result.items() if motor["zeroed"]] == ["joint_2", "joint_5"]
    assert result["joint_2"]["before_motor_rad"] == pytest.approx(-0.2, abs=0.01)
    assert result["joint_2"]["after_joint_rad"] == pytest.approx(0.0, abs=0.01)
    assert result["gripper"]["after_joint_rad"] is None


def test_a_zeroed_arm_is_where_it_says(crooked):
    """Joints 2, 3, 5, 6 and 1 lie at zero; joint 4 does not and keeps its zero, right from the start here."""
    rest = np.array(crooked.state()["arms"]["only"]["q"])
    assert np.abs(np.delete(rest, 3)).max() < 0.02
    joints = ["joint_1", "joint_2", "joint_3", "joint_5", "joint_6"]
    assert main(arguments(crooked, "--joint", *joints, "--yes")) == 0
    with YamArm(config(crooked)) as arm:
        difference = arm.observe().q - crooked.state()["arms"]["only"]["q"]
        assert np.abs(np.delete(difference, 3)).max() < 0.02
        assert difference[3] == pytest.approx(OFFSETS[3], abs=0.02)


def test_a_motor_on_another_turn_and_turned_round_is_zeroed(tmp_path):
    offsets = [0.0, TURN + 0.2, 0.0, 0.0, -TURN, 0.0]
    with running_rig(scene=scene(tmp_path, offsets, "big_yam", "no_gripper")) as rig:
        assert main(arguments(rig, "--arm", "big_yam", "--joint", "joint_2", "joint_5", "--yes")) == 0
        after = motor_rad(rig)
        assert abs(after["joint_2"]) < 0.005 and abs(after["joint_5"]) < 0.005


def test_a_leader_is_zeroed_too(rig):
    assert main(arguments(rig, "--joint", "joint_3", "--yes", channel="leader_left")) == 0


def test_an_unresolvable_joint_is_shown_and_can_be_zeroed(tmp_path, capsys):
    """The very case for which zeroing is advised."""
    with running_rig(scene=scene(tmp_path, [3.4, 0, 0, 0, 0, 0, 0])) as rig:
        with pytest.raises(MotorError, match=f"yam-zero --channel only --rig {rig.name} --joint joint_1"):
            YamArm(config(rig)).connect()
        assert main(arguments(rig, "--joint", "joint_2", "--yes")) == 0
        said = capsys.readouterr()
        assert "unclear" in said.out and "note: only: joint_1 reads 3.4" in said.err
        assert main(arguments(rig, "--joint", "joint_1", "--yes")) == 0
        with YamArm(config(rig)) as arm:
            assert abs(arm.observe().q[0]) < 0.02


@pytest.mark.parametrize("arm", ARMS)
def test_every_joint_has_its_zero_pose_described_truthfully(arm):
    described = load_arm(arm)
    assert list(described.zero_pose) == [motor.name for motor in described.motors]
    for motor, (low, high) in zip(described.motors, described.joint_limits_rad, strict=True):
        assert low <= 0.0 <= high
        assert ("lower stop" in described.zero_pose[motor.name]) == (low == 0.0)


# what speaks against it


def refused(rig, capsys, *more, channel="only"):
    """What it says; nothing was sent but questions."""
    rig.trace_start(channel)
    before = motor_rad(rig, channel)
    assert main(arguments(rig, *more, channel=channel)) == 1
    assert sent(rig, channel) == []
    return capsys.readouterr().err, before


def test_without_a_terminal_or_yes_nothing_is_zeroed(crooked, capsys, monkeypatch):
    monkeypatch.setattr(sys, "stdin", open(os.devnull))
    said, _ = refused(crooked, capsys)
    assert "no terminal" in said
    sys.stdin.close()


def test_a_running_session_is_left_alone(rig, capsys):
    with YamArm(config(rig, channel="follower_left")):
        assert main(arguments(rig, "--yes", channel="follower_left")) == 1
        assert "in use by process" in capsys.readouterr().err
    assert abs(motor_rad(rig, "follower_left")["joint_4"]) > 0.1


def test_an_energised_motor_refuses(crooked, capsys):
    """Enabled and left to itself, as after a crash; its watchdog gives up only after 20 s here."""
    crooked.fault("only", "gripper", "register", 400_000, register=int(Register.TIMEOUT))
    with can.Bus(interface="yam_sim", channel="only", rig=crooked.name) as bus:
        bus.send(can.Message(arbitration_id=7, data=SpecialCommand.ENABLE.value, is_extended_id=False))
        crooked.wait_event("motor_enabled", 5.0)
    said, _ = refused(crooked, capsys, "--joint", "joint_1", "--yes")
    assert "only (only): gripper energised; zeroing is for limp motors" in said


def test_a_motor_with_a_fault_refuses_to_be_zeroed(crooked, capsys):
    crooked.fault("only", "joint_3", "nibble", int(Fault.ROTOR_OVER_TEMPERATURE))
    said, _ = refused(crooked, capsys, "--joint", "joint_3", "--yes")
    assert "joint_3: 0xC coil too hot" in said and "power off and on" in said
    assert main(arguments(crooked, "--joint", "joint_2", "--yes")) == 0


def test_a_moving_joint_refuses(crooked, capsys):
    crooked.push("only", "link6", [0, 6, 0], 20.0)  # turns joint 1
    said, before = refused(crooked, capsys, "--joint", "joint_1", "--yes")
    assert "joint_1 moved by" in said and "nothing was zeroed" in said
    assert abs(motor_rad(crooked)["joint_1"] - before["joint_1"]) > 0.005  # it did


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--joint", "joint_7", "--yes"], "no joint joint_7; arm 'yam' has joint_1, joint_2"),
        (["--joint", "gripper", "--yes"], "no joint gripper"),
        (["--arm", "none", "--yes"], "a gripper has no zero to set"),
        (["--arm", "yam_max", "--yes"], "unknown arm 'yam_max'"),
        (["--arm", "big_yam", "--yes"], "motor joint_1 .*GR is 40 instead of 48"),
    ],
)
def test_what_does_not_exist_is_refused_by_name(crooked, capsys, more, message):
    said, _ = refused(crooked, capsys, *more)
    assert re.search(message, said), said


def test_a_silent_motor_refuses(crooked, capsys):
    crooked.fault("only", "joint_4", "silent")
    said, _ = refused(crooked, capsys, "--joint", "joint_1", "--yes")
    assert "no answer from 1 of 7 motors: joint_4 (id 4)" in said


# at a terminal


def at_terminal(rig, *lines):
    """Exit status and what it said, with lines typed one after the other."""
    ours, theirs = pty.openpty()
    try:
        process = subprocess.Popen(
            [sys.executable, "-m", "lerobot_robot_yam.commands.zero", *arguments(rig, "--joint", "joint_1")],
            stdin=theirs,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        said, reader = [], threading.Thread(target=lambda: said.extend(iter(lambda: process.stderr.read(1), "")))
        reader.start()
        for prompt, line in lines:
            deadline = time.monotonic() + 60
            while prompt not in "".join(said):
                assert time.monotonic() < deadline and process.poll() is None, "".join(said)
                time.sleep(0.02)
            os.write(ours, line)
        status = process.wait(timeout=60)
        reader.join()
        process.stdout.close()
        process.stderr.close()
        return status, "".join(said)
    finally:
        os.close(ours)
        os.close(theirs)


def test_at_a_terminal_it_shows_the_angles_live_until_the_joints_are_placed(crooked):
    status, said = at_terminal(crooked, ("motor rad: joint_1 +0.30", b"\n"), ("Type zero", b"zero\n"))
    assert status == 0, said
    assert "joint_1 (range -2.62 … +3.14 rad): base:" in said
    assert abs(motor_rad(crooked)["joint_1"]) < 0.005


@pytest.mark.parametrize("answer", [b"yes\n", b"\n", b"\x04"])
def test_anything_but_the_word_zeroes_nothing(crooked, answer):
    crooked.trace_start("only")
    status, said = at_terminal(crooked, ("Press Enter", b"\n"), ("Type zero", answer))
    assert status == 1
    assert "nothing" in said and sent(crooked) == []
