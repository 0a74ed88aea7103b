"""yam-handle on the rig: what it shows, and that every setting is read back."""

import contextlib
import json
import os
import sys

import can
import pytest

from lerobot_robot_yam.commands.handle import HANDLE, main
from lerobot_robot_yam.control.gripper.trigger_range import load_range
from lerobot_robot_yam.damiao.handle_encoder import REQUEST_ID, encode_report_frequency
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from tests.support.crooked_arm import arguments

CHANNEL = "leader_left"


@pytest.fixture
def desk():
    with contextlib.closing(LockstepRig()) as rig:
        rig.trigger(CHANNEL, 0.0)
        yield rig


def squeeze(rig, shares, every_s):
    """From now on the trigger goes from one share to the next as time passes, and stays at the last one."""
    pause, left, begin_s = rig.sleep, iter(enumerate(shares)), rig.now()
    step = [next(left)]

    def sleep(seconds):
        pause(seconds)
        while step[0] is not None and rig.now() >= begin_s + step[0][0] * every_s:
            rig.trigger(CHANNEL, step[0][1])
            step[0] = next(left, None)

    rig.sleep = sleep


def run(rig, action, *more, channel=CHANNEL):
    return main([action, *map(str, more), *arguments(rig, channel=channel)])


def shown(rig, capsys, *more):
    capsys.readouterr()
    assert run(rig, "show", "--json", *more) == 0
    return json.loads(capsys.readouterr().out)


def test_it_shows_what_the_handle_is_and_reads(desk, capsys):
    desk.trigger(CHANNEL, 0.5)
    desk.buttons(CHANNEL, False, True)
    found = shown(desk, capsys)
    desk.buttons(CHANNEL, False, False)
    assert (found["firmware"], found["report_frequency_hz"], found["buttons"]) == ("2.4.0", 0, [0, 1])
    assert found["trigger"] == pytest.approx(0.5, abs=0.01)
    assert run(desk, "show") == 0
    assert "firmware             2.4.0" in capsys.readouterr().out


def test_a_handle_that_reports_by_itself_is_told_and_set(desk, capsys):
    with can.Bus(interface="yam_lockstep", channel=CHANNEL, rig=desk.name) as bus:
        bus.send(can.Message(arbitration_id=REQUEST_ID, data=encode_report_frequency(300), is_extended_id=False))
    assert run(desk, "show") == 0
    assert "note: it takes 300 frames a second from the motors: yam-handle report 0" in capsys.readouterr().err
    assert run(desk, "report", 0) == 0
    assert "only when it is asked; read back" in capsys.readouterr().err
    assert shown(desk, capsys)["report_frequency_hz"] == 0
    assert run(desk, "report", 601) == 1
    assert "a handle reports 0 to 600 times a second, not 601" in capsys.readouterr().err


def test_a_released_trigger_is_zeroed(desk, capsys):
    desk.trigger(CHANNEL, 0.2)  # where this one is when it is let go
    assert run(desk, "zero", "--yes") == 0
    assert "the trigger reads +0.1" in capsys.readouterr().err
    found = shown(desk, capsys)
    assert found["trigger_rad"] == pytest.approx(0.0, abs=0.005) and found["zero_counts"] == pytest.approx(91, abs=1)
    desk.trigger(CHANNEL, 0.0)
    assert run(desk, "zero", "--yes") == 0


def test_a_moving_trigger_is_not_zeroed(desk, capsys):
    squeeze(desk, [share / 60 for share in range(60)], 0.02)
    assert run(desk, "zero", "--yes") == 1
    assert "its zero was left as it is. Let go of it" in capsys.readouterr().err
    assert shown(desk, capsys)["zero_counts"] == 0


def test_the_triggers_range_is_learnt_into_a_file(desk, capsys, tmp_path):
    path = tmp_path / "left.json"
    squeeze(desk, (0.1, 0.9, 0.1, 0.9, 0.1), 0.3)
    assert run(desk, "range", "--calibration", path, "--seconds", 1.6) == 0
    found = load_range("left", path, HANDLE)
    assert found == pytest.approx((0.116, 0.884), abs=0.01)
    desk.trigger(CHANNEL, 0.1)
    assert shown(desk, capsys, "--calibration", path)["trigger"] == 0.0
    assert run(desk, "range", "--calibration", tmp_path / "none.json", "--seconds", 0.2) == 1
    assert "the trigger has moved by 0 % of its travel; squeeze it fully" in capsys.readouterr().err
    assert not (tmp_path / "none.json").exists()


def test_trigger_and_buttons_are_shown_live(desk, capsys):
    desk.trigger(CHANNEL, 1.0)
    desk.buttons(CHANNEL, True, False)
    assert run(desk, "live", "--seconds", 0.3) == 0
    desk.buttons(CHANNEL, False, False)
    said = capsys.readouterr().err
    assert "trigger 1.00 [####################] +0.699" in said and "sync DOWN  record up" in said


def test_what_is_no_handle_is_named(desk, capsys, monkeypatch):
    assert run(desk, "show", channel="follower_left") == 1
    assert "follower_left: no teaching handle answers; check that this is a leader" in capsys.readouterr().err
    with open(os.devnull) as nothing:
        monkeypatch.setattr(sys, "stdin", nothing)
        assert run(desk, "zero") == 1
    assert "no terminal to confirm at" in capsys.readouterr().err


def test_a_leader_without_motors_is_no_handle(capsys):
    with contextlib.closing(LockstepRig("passive_leaders")) as rig:
        assert run(rig, "report", 0) == 1
        assert "7 encoders answer (0, 1, 2, 3, 4, 5, 6): this is a leader without motors" in capsys.readouterr().err
