"""yam-motors on the rig: what it shows, what it changes, and that it changes everything it said or nothing."""

import contextlib
import json
import os
import sys

import can
import pytest

from lerobot_robot_yam.commands.lib.arm_command import own_bus
from lerobot_robot_yam.commands.motors import main
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from tests.support import base_rig
from tests.support.crooked_arm import arguments, config, events, scene, sent
from tests.support.motor_commands import cycle, read, refused, run, value, writes

pytestmark = pytest.mark.usefixtures("state_home")


# looking


def test_scan_shows_who_is_there_and_only_asks(arm, capsys):
    arm.fault("only", "joint_5", "nibble", int(Fault.OVERLOAD))
    arm.fault("only", "joint_6", "temperatures_c", [61, 74])
    arm.trace_start("only")
    assert run(arm, "scan") == 0
    shown = capsys.readouterr().out
    lines = {line.split()[0]: line for line in shown.splitlines()}
    assert list(lines)[1:] == [*(f"joint_{i}" for i in range(1, 7)), "gripper"]
    assert "DM4340" in lines["joint_1"] and "12.5 10 28" in lines["joint_1"] and "5013.0" in lines["joint_1"]
    assert "0xE overload" in lines["joint_5"] and " 61 " in lines["joint_6"] and " 74 " in lines["joint_6"]
    assert sent(arm) == [] and not events(arm, "motor_enabled") and not any(writes(arm).values())


def test_scan_says_what_is_wrong_with_ids(arm, capsys):
    arm.fault("only", "joint_2", "duplicate")
    arm.fault("only", "joint_3", "wrong_id", 0x25)
    arm.fault("only", "joint_4", "silent")
    arm.fault("only", "joint_5", "register", 0, register=int(Register.TIMEOUT))
    arm.fault("only", "joint_6", "register", 12, register=int(Register.ESC_ID))
    arm.fault("only", "gripper", "register", 0, register=int(Register.MST_ID))
    assert run(arm, "scan", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found["motors"]) == ["1", "2", "3", "5", "7", "12"]
    assert found["motors"]["2"]["answers"] == [18, 18] and found["motors"]["3"]["answers"] == [0x25]
    notes = "\n".join(found["notes"])
    assert "2 motors answer to id 2" in notes and "joint_3 answers as 0x25, which is not its MST_ID" in notes
    assert "joint_5 has another time-out" in notes and "no answer from joint_4 (id 4), joint_6 (id 6)" in notes
    again = f"yam-motors set-id {config(arm).on_command_line} 7 7"
    assert f"gripper answers as 0, not 23: {again}" in notes


def test_a_leader_has_a_handle_in_the_place_of_a_gripper(capsys):
    with contextlib.closing(LockstepRig()) as rig:
        assert main(["scan", "--json", *arguments(rig, channel="leader_left")]) == 0
    (note,) = json.loads(capsys.readouterr().out)["notes"]
    assert "a teaching handle answers instead of a gripper's motor (yam-handle show --channel leader_left" in note


def test_a_silent_channel_says_what_to_check(arm, capsys):
    arm.fault("only", None, "silent")
    for action in ("scan", "read", "timeout"):
        assert run(arm, action) == 1
        assert "nothing answers on channel only; check motor power" in capsys.readouterr().err


def test_registers_are_read_by_name_or_number(arm, capsys):
    assert read(arm, capsys, "timeout", "21", "--motor", "gripper,1") == {
        "7": {"TIMEOUT": 8000, "PMAX": 12.5},
        "1": {"TIMEOUT": 8000, "PMAX": 12.5},
    }
    assert run(arm, "read", "OC_VALUE") == 0
    assert "OC_VALUE     0.98" in capsys.readouterr().out


# registers


def test_a_write_lasts_until_the_power_goes_and_a_stored_one_longer(arm, capsys):
    assert run(arm, "write", "OT_VALUE=90", "--motor", "joint_3", "--yes") == 0
    assert "OT_VALUE  100.0  90.0" in capsys.readouterr().err
    assert value(arm, capsys, "joint_3", "OT_VALUE") == 90.0
    cycle(arm, "joint_3")
    assert value(arm, capsys, "joint_3", "OT_VALUE") == 100.0
    assert run(arm, "write", "OT_VALUE=90", "--motor", "joint_3", "--store", "--yes") == 0
    cycle(arm, "joint_3")
    assert run(arm, "write", "OT_VALUE=90", "OC_VALUE=0.98", "--motor", "joint_3", "--store", "--yes") == 0
    assert "hold that already; nothing was written" in capsys.readouterr().err
    assert writes(arm)["joint_3"] == sum(writes(arm).values()) == 1
    assert run(arm, "write", "UV_VALUE=14", "--motor", "joint_3", "--yes") == 0
    assert run(arm, "store", "--motor", "joint_3", "--yes") == 0
    assert "stored, and read back: joint_3" in capsys.readouterr().err
    cycle(arm, "joint_3")
    assert value(arm, capsys, "joint_3", "UV_VALUE") == 14.0


def test_firmware_that_reverts_other_registers_is_found_and_corrected(arm, capsys):
    arm.fault("only", "joint_2", "storing", "reverts")
    new = ["OT_VALUE=90", "UV_VALUE=14", "KT_VALUE=0.5"]
    assert run(arm, "write", *new, "--motor", "joint_2", "--store", "--yes") == 0
    assert "note: storing put other registers of joint_2 back" in capsys.readouterr().err
    cycle(arm, "joint_2")
    held = read(arm, capsys, "OT_VALUE", "UV_VALUE", "KT_VALUE", "--motor", "joint_2")["2"]
    assert held == {"OT_VALUE": 90.0, "UV_VALUE": 14.0, "KT_VALUE": 0.5}


def test_a_power_cut_while_storing_is_told_and_can_be_undone(arm, capsys, state_home):
    new = ["OT_VALUE=90", "UV_VALUE=14"]
    arm.fault("only", "joint_2", "storing", "cut")
    assert run(arm, "write", *new, "--motor", "joint_1,joint_2,joint_3", "--store", "--yes") == 1
    said = capsys.readouterr().err
    assert "motor 2 fell silent while it stored" in said and "Stored before that: joint_1" in said
    (kept,) = state_home.iterdir()
    assert "The other motors are as before" in said and str(kept) in said
    assert value(arm, capsys, "joint_3", "OT_VALUE") == 100.0  # put back in RAM
    arm.fault("only", "joint_2", "power", True)
    arm.clear_faults("only")
    half = read(arm, capsys, "OT_VALUE", "UV_VALUE", "--motor", "joint_2")["2"]
    assert half == {"OT_VALUE": 100.0, "UV_VALUE": 14.0}
    assert run(arm, "restore", kept, "--yes") == 0
    cycle(arm)
    held = read(arm, capsys, "OT_VALUE", "UV_VALUE")
    assert all(motor == {"OT_VALUE": 100.0, "UV_VALUE": 15.0} for motor in held.values())
    assert [*state_home.iterdir()] == [kept]


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (["write", "OT_VALUE=90", "--yes"], "name the motors to write to"),
        (["write", "OT_VALUE", "--motor", "1", "--yes"], "'OT_VALUE' is no setting: write REGISTER=VALUE"),
        (["write", "OTT=9", "--motor", "1", "--yes"], "no register 'OTT'; known: UV_VALUE"),
        (["write", "SN=9", "--motor", "1", "--yes"], "register SN is read-only"),
        (["write", "OT_VALUE=20", "--motor", "1", "--yes"], "OT_VALUE takes values from 80 to below 200 °C, not 20"),
        (["write", "PMAX=nan", "--motor", "1", "--yes"], "register PMAX cannot hold nan"),
        (["write", "ESC_ID=9", "--motor", "1", "--yes"], "change it with yam-motors set-id"),
        (["write", "TIMEOUT=9", "--motor", "1", "--yes"], "change it with yam-motors timeout"),
        (["write", "CAN_BR=3", "--motor", "1", "--yes"], "at another bit-rate the motor is not heard"),
        (["write", "OT_VALUE=90", "--motor", "elbow", "--yes"], "no motor 'elbow'; give a CAN id, or one of joint_1"),
        (["write", "OT_VALUE=90", "--motor", "11", "--yes"], "motor 11 (id 11) does not answer"),
        (["read", "--motor", "11"], "motor 11 (id 11) does not answer"),
        (["timeout", "8000", "--yes"], "the time-out is 8000 s: give seconds, 0.05 to 10"),
        (["timeout", "0.001", "--yes"], "factory value of 8000 is 0.4 s"),
        (["timeout", "nan", "--yes"], "the time-out is nan s"),
        (["set-id", "7", "16", "--yes"], "id 16 cannot be used: feedback tells ids 1 to 15 apart"),
        (["set-id", "70000", "9", "--yes"], "70000 is no CAN id of a motor"),
        (["read", "--motor", "70000"], "no motor '70000'"),
        (["set-id", "7", "9", "--answers", "3", "--yes"], "a motor cannot answer as 3"),
        (["set-id", "9", "10", "--yes"], "motor 9 (id 9) does not answer"),
        (["set-id", "7", "3", "--yes"], "another motor has id 3 already; nothing was changed"),
        (["set-id", "7", "9", "--answers", "19", "--yes"], "motor 3 answers as 19 already; nothing was changed"),
        (["diff", "/nowhere.yaml"], "cannot read /nowhere.yaml"),
        (["dump", "/proc/left.yaml"], "/proc/left.yaml cannot be written"),
    ],
)
def test_mistakes_are_named_and_change_nothing(lasting, capsys, action, message):
    assert message in refused(lasting, capsys, *action)


@pytest.fixture(scope="module")
def lasting(tmp_path_factory):
    """A rig with one arm, for what changes nothing."""
    with contextlib.closing(LockstepRig(scene(tmp_path_factory.mktemp("scene"), [0.0] * 7))) as rig:
        yield rig


@pytest.mark.parametrize("seconds", ["nan", "inf", "0", "-1", "long"])
def test_a_time_that_does_not_pass_is_refused(capsys, seconds):
    with pytest.raises(SystemExit):
        main(["monitor", "--channel", "nowhere", "--seconds", seconds])
    assert "argument --seconds: " in capsys.readouterr().err


# what speaks against a change


def test_without_a_terminal_or_yes_nothing_is_changed(lasting, capsys, monkeypatch):
    with open(os.devnull) as nothing:
        monkeypatch.setattr(sys, "stdin", nothing)
        for action in (["timeout", "0"], ["set-id", "7", "9"], ["store"], ["write", "OT_VALUE=90", "--motor", "1"]):
            assert "no terminal to confirm at" in refused(lasting, capsys, *action)


@pytest.mark.parametrize(
    ("action", "word"),
    [
        (["write", "OT_VALUE=90", "--motor", "1"], "write"),
        (["store", "--motor", "1"], "store"),
        (["set-id", "7", "9"], "set-id"),
        (["timeout", "0.3"], "timeout"),
        (["timeout", "0"], "never"),
    ],
)
def test_anything_but_the_word_changes_nothing(lasting, capsys, type_in, action, word):
    type_in(b"yes\n")
    said = refused(lasting, capsys, *action)
    assert f"Type {word} to " in said and "not confirmed; nothing was changed" in said
    type_in(b"\x04")
    assert "the terminal gave no answer" in refused(lasting, capsys, *action)


def test_the_word_changes_it(arm, capsys, type_in):
    type_in(b"write\n")
    assert run(arm, "write", "OT_VALUE=90", "--motor", "joint_1") == 0
    assert value(arm, capsys, "joint_1", "OT_VALUE") == 90.0


def test_a_channel_in_use_is_left_alone(arm, capsys):
    with own_bus(config(arm)):
        for action in (["scan"], ["timeout", "0", "--yes"]):
            assert "in use by process" in refused(arm, capsys, *action)


def test_motors_that_hold_something_up_are_left_alone(arm, capsys):
    """Energised and left to itself, as after a crash; its watchdog gives up only after 20 s here."""
    arm.fault("only", "joint_2", "register", 400_000, register=int(Register.TIMEOUT))
    with can.Bus(interface="yam_lockstep", channel="only", rig=arm.name) as bus:
        bus.send(can.Message(arbitration_id=2, data=SpecialCommand.ENABLE.value, is_extended_id=False))
        arm.sleep(0.1)
        assert events(arm, "motor_enabled")
    for action in (
        ["timeout", "0.4"],
        ["write", "OT_VALUE=90", "--motor", "1,joint_2"],
        ["store"],
        ["set-id", 2, 9],
    ):
        said = refused(arm, capsys, *action, "--yes")
        assert "joint_2 (id 2) is energised; nothing was changed. Motors are set up while they are limp" in said
    assert value(arm, capsys, "joint_1", "OT_VALUE") == 100.0


def test_a_motor_with_a_fault_or_a_wrong_answer_is_not_set_up(arm, capsys):
    arm.fault("only", "joint_3", "nibble", int(Fault.ROTOR_OVER_TEMPERATURE))
    assert "reports 0xC coil too hot" in refused(arm, capsys, "store", "--motor", "joint_3", "--yes")
    arm.fault("only", "joint_4", "wrong_id", 0x25)
    said = refused(arm, capsys, "set-id", 4, 9, "--yes")
    assert "joint_4 (id 4) answers as 0x25, but its MST_ID is 0x14; nothing was changed" in said


def test_the_motors_of_a_base(capsys):
    with contextlib.closing(LockstepRig("mobile")) as rig:
        assert main(["scan", "--json", *base_rig.arguments(rig)]) == 0
        found = json.loads(capsys.readouterr().out)
        assert [row["name"] for row in found["motors"].values()] == list(base_rig.motors(rig)) and not found["notes"]
        assert main(["read", "CTRL_MODE", "--json", "--motor", "rear_left_drive", *base_rig.arguments(rig)]) == 0
        assert json.loads(capsys.readouterr().out)["motors"] == {"2": {"CTRL_MODE": 3}}
        assert main(["write", "OT_VALUE=90", "--store", "--motor", "4", "--yes", *base_rig.arguments(rig)]) == 0
        assert base_rig.motors(rig)["front_left_drive"]["flash_writes"] == 1


@pytest.mark.parametrize("arm", [["--arm", "base"], []], ids=["base", "unnamed"])
def test_no_console_for_the_motors_of_a_base(type_in, capsys, arm):
    """It would put them into another mode."""
    type_in(b"enable\n")
    with contextlib.closing(LockstepRig("mobile")) as rig:
        assert main(["console", "--motor", "3", *base_rig.arguments(rig, arm=arm)]) == 1
        assert "is a base's motor: it obeys velocities only" in capsys.readouterr().err
        assert not any(motor["enabled"] for motor in base_rig.motors(rig).values())
