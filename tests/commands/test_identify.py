"""yam-identify on the rig: reads, binds, checks, and wiggles only when it was confirmed."""

import json
import os
import sys
import threading
import time

import can
import numpy as np
import pytest

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.commands.identify import SPEED_RAD_S, WIGGLE_RAD, hazard, main
from lerobot_robot_yam.control.gripper.gripper_stops import GripperStops, save_stops
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.session.yam_arm import YamArm
from scripts import recorders

STOPS = [3.25, -3.3]


def energised(rig):
    return [event for event in rig.events() if event["kind"] == "motor_enabled"]


def limp(rig, channel="follower_left"):
    return not any(motor["enabled"] for motor in rig.state()["arms"][channel]["motors"].values())


def arguments(rig, channel="follower_left", *more):
    return ["--channel", channel, "--rig", rig.name, *map(str, more)]


@pytest.fixture
def wiggle(rig, tmp_path, capsys):
    """Runs the command with --wiggle and stored stops; returns its exit status and what it has said."""
    save_stops("left", tmp_path / "stops.json", "linear_4310", GripperStops(*STOPS))

    def run(*more):
        status = main(arguments(rig, "follower_left", "--wiggle", "--calibration", tmp_path / "stops.json", *more))
        return status, capsys.readouterr().err

    return run


def test_it_shows_what_answers_and_sends_questions_only(rig, capsys):
    rig.trace_start("leader_left")
    assert main(arguments(rig, "leader_left")) == 0
    shown = capsys.readouterr().out
    assert "channel leader_left: leader (a teaching handle answers)" in shown
    assert "firmware 2.4.0" in shown and shown.count("DM4340") == 3 and shown.count("DM4310") == 3
    assert {ident for _, _, ident, _ in rig.trace("leader_left")} == {0x7FF, 0x50E}
    assert main(arguments(rig, "leader_left", "--json")) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["channel"] == "leader_left" and len(found["motors"]) == 6 and found["handle_firmware"] == [2, 4, 0]


def test_bound_arms_are_recognised_and_swapped_ones_are_not(rig, tmp_path, capsys):
    for side in ("left", "right"):
        path, channel = tmp_path / f"{side}.json", f"follower_{side}"
        assert main(arguments(rig, channel, "--name", f"{side}_lab", "--bind", path)) == 0
        assert main(arguments(rig, channel, "--check", path)) == 0
    capsys.readouterr()
    assert main(arguments(rig, "follower_right", "--check", tmp_path / "left.json")) == 1
    assert "channel follower_right carries the arm bound as 'right_lab', not 'left_lab'" in capsys.readouterr().err
    assert main(arguments(rig, "follower_right", "--bind", tmp_path / "left.json")) == 1
    assert "already binds 'left_lab'" in capsys.readouterr().err
    assert main(arguments(rig, "follower_right", "--bind", tmp_path / "left.json", "--force")) == 0
    assert "cannot be told apart from the one bound as 'right_lab', or it is the same" in capsys.readouterr().err
    assert main(arguments(rig, "follower_right", "--check", tmp_path / "none.json")) == 1
    assert "there is no arm binding" in capsys.readouterr().err
    assert not energised(rig)


def test_a_changed_serial_number_fails_the_check(rig, tmp_path, capsys):
    assert main(arguments(rig, "follower_left", "--name", "left", "--bind", tmp_path / "left.json")) == 0
    rig.fault("follower_left", "joint_3", "register", 77, register=int(Register.SN))
    assert main(arguments(rig, "follower_left", "--check", tmp_path / "left.json")) == 1
    assert "1 of 7 motors have another serial number (id 3)" in capsys.readouterr().err


def test_a_channel_in_use_is_left_alone(rig, capsys):
    fields = {"channel": "follower_left", "interface": "yam_sim", "can_options": {"rig": rig.name}}
    with YamArm(gripper_stops_rad=STOPS, **fields):
        rig.trace_start("follower_left")
        assert main(arguments(rig)) == 1
        assert "in use by process" in capsys.readouterr().err
        time.sleep(0.1)
        assert {ident for _, _, ident, _ in rig.trace("follower_left")} == {1, 2, 3, 4, 5, 6, 7}  # the session's own


def test_a_dead_channel_says_so(rig, capsys):
    rig.fault("follower_left", None, "silent")  # no power
    assert main(arguments(rig)) == 1
    assert "nothing answers on channel follower_left; check motor power" in capsys.readouterr().err
    assert main(["--channel", "can_none", "--rig", rig.name]) == 1
    assert "can_none" in capsys.readouterr().err


def test_without_a_terminal_or_yes_nothing_wiggles(rig, wiggle, monkeypatch):
    rig.trace_start("follower_left")
    with open(os.devnull) as nothing:
        monkeypatch.setattr(sys, "stdin", nothing)
        status, said = wiggle()
    assert status == 1 and "no terminal" in said and rig.trace("follower_left") == []


@pytest.mark.parametrize(("stored", "moves"), [(None, True), ("typo.json", True), ("stops.json", False)])
def test_who_confirms_is_told_when_the_fingers_will_move_too(tmp_path, stored, moves):
    save_stops("left", tmp_path / "stops.json", "linear_4310", GripperStops(*STOPS))
    path = None if stored is None else str(tmp_path / stored)
    assert ("closes and opens fully" in hazard(ArmConfig(channel="can0", calibration_path=path))) == moves


def test_a_wiggle_turns_joint_6_slowly_and_nothing_else_and_lands(rig, wiggle):
    rest = np.array(rig.state()["arms"]["follower_left"]["q"])
    recorders.truth_start(rig, "follower_left", 60.0)
    status, said = wiggle("--yes")
    assert status == 0 and "HAZARD" in said and limp(rig) and limp(rig, "follower_right")
    truth = recorders.truth(rig, "follower_left")
    q, dq = truth["q"], truth["dq"]
    assert q[:, 5].max() - rest[5] == pytest.approx(WIGGLE_RAD, abs=0.02)
    assert q[:, 5].min() - rest[5] == pytest.approx(-WIGGLE_RAD, abs=0.02)
    until = q[:, 5].argmin()  # afterwards it lands
    assert np.abs(q[:until, :5] - rest[:5]).max() < 0.05
    assert np.abs(dq[:until, 5]).max() < 2 * SPEED_RAD_S


@pytest.mark.long
def test_at_a_terminal_it_wiggles_again_until_the_arm_is_named_and_binds_it(rig, wiggle, type_in, tmp_path):
    type_in(b"wiggle\n\nthe left one\n")
    status, said = wiggle("--bind", tmp_path / "b.json")
    assert status == 0 and said.count("Which arm moved?") == 2
    assert "bound as 'the left one'" in said and json.loads((tmp_path / "b.json").read_text())["name"] == "the left one"
    assert len(energised(rig)) == 7 and limp(rig)


@pytest.mark.long
def test_another_arm_than_named_moved_and_nothing_is_bound(rig, wiggle, type_in, tmp_path):
    type_in(b"wiggle\nright\n")
    status, said = wiggle("--name", "left", "--bind", tmp_path / "b.json")
    assert status == 1 and "'right' moved, not 'left'" in said
    assert not (tmp_path / "b.json").exists() and limp(rig)


def test_an_unconfirmed_wiggle_energises_nothing(rig, wiggle, type_in):
    type_in(b"yes\n")
    status, said = wiggle()
    assert status == 1 and "not confirmed; nothing was energised" in said and not energised(rig)


def test_another_driver_on_the_wire_is_heard(rig, capsys):
    """A lock keeps out our own processes only."""
    stop = threading.Event()
    with can.Bus(interface="yam_sim", channel="follower_left", rig=rig.name) as bus:

        def drive():
            while not stop.wait(0.002):
                bus.send(can.Message(arbitration_id=3, data=bytes(8), is_extended_id=False))

        thread = threading.Thread(target=drive)
        thread.start()
        try:
            assert main(arguments(rig)) == 1
        finally:
            stop.set()
            thread.join()
    assert "already being driven" in capsys.readouterr().err
