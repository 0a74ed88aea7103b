"""yam-motors on the rig: ids, time-outs and dumps, set whole or not at all."""

import can
import pytest
import yaml

from lerobot_robot_yam.damiao.registers import Register, encode_read
from tests.support.motor_commands import cycle, read, refused, run, value, writes

pytestmark = pytest.mark.usefixtures("state_home")


# ids


def test_a_motor_gets_its_id_and_keeps_it(arm, capsys, state_home):
    """As from the factory: id 1 and answers as 0, alone on the bus."""
    arm.fault("only", None, "silent")
    arm.fault("only", "gripper", "silent", False)
    arm.fault("only", "gripper", "register", 0, register=int(Register.MST_ID))
    arm.fault("only", "gripper", "register", 9, register=int(Register.ESC_ID))
    assert run(arm, "set-id", 9, 7, "--yes") == 0
    assert "motor 9 is now motor 7 and answers as 23; stored and read back" in capsys.readouterr().err
    cycle(arm, "gripper")
    assert read(arm, capsys, "ESC_ID", "MST_ID", "--motor", "gripper") == {"7": {"ESC_ID": 7, "MST_ID": 23}}
    assert run(arm, "set-id", 7, 7, "--yes") == 0
    assert "has these ids already; nothing was written" in capsys.readouterr().err
    assert writes(arm)["gripper"] == 1 and not list(state_home.iterdir())


def test_firmware_that_reverts_gets_both_ids_all_the_same(arm, capsys):
    arm.fault("only", "gripper", "storing", "reverts")
    assert run(arm, "set-id", 7, 9, "--yes") == 0
    assert "storing put MST_ID back" in capsys.readouterr().err
    cycle(arm, "gripper")
    assert read(arm, capsys, "MST_ID", "--motor", "9") == {"9": {"MST_ID": 25}}


def test_ids_that_were_half_stored_when_the_power_went_are_set_again(arm, capsys, state_home):
    arm.fault("only", "gripper", "storing", "cut")
    assert run(arm, "set-id", 7, 9, "--yes") == 1
    said, (kept,) = capsys.readouterr().err, state_home.iterdir()
    assert "motor 9 fell silent while it stored its registers" in said and str(kept) in said
    arm.fault("only", "gripper", "power", True)
    arm.clear_faults("only")
    assert read(arm, capsys, "MST_ID", "--motor", "7") == {"7": {"MST_ID": 25}}
    assert run(arm, "set-id", 7, 9, "--yes") == 0
    cycle(arm, "gripper")
    assert read(arm, capsys, "MST_ID", "--motor", "9") == {"9": {"MST_ID": 25}}
    assert [*state_home.iterdir()] == [kept]


def test_two_motors_with_one_id_are_not_changed_nor_taken_for_one(arm, capsys, tmp_path):
    path = tmp_path / "left.yaml"
    assert run(arm, "dump", path) == 0
    arm.fault("only", "joint_2", "duplicate")
    for action in (["set-id", 2, 9], ["write", "OT_VALUE=90", "--motor", "joint_2"], ["timeout", "0.3"]):
        said = refused(arm, capsys, *action, "--yes")
        assert "2 motors answer to id 2; nothing was changed. Unplug all but one" in said
    for action in (["read"], ["dump", tmp_path / "mixed.yaml"], ["diff", path], ["timeout"]):
        assert "2 motors answer to id 2" in refused(arm, capsys, *action)
    assert not (tmp_path / "mixed.yaml").exists()
    assert len(read(arm, capsys, "--motor", "joint_1")) == 1  # the others can be looked at


# time-outs


def test_the_time_out_is_set_in_seconds_stored_and_read_back(arm, capsys):
    assert run(arm, "timeout", "0", "--motor", "joint_1", "--yes") == 0
    said = capsys.readouterr().err
    assert "HAZARD: without a time-out" in said and "sessions refuse an arm whose time-out is not 0.4 s" in said
    cycle(arm, "joint_1")
    assert run(arm, "timeout") == 0
    shown = capsys.readouterr().out
    assert shown.splitlines()[1].split() == ["joint_1", "0", "never"]
    assert shown.splitlines()[2].split() == ["joint_2", "8000", "0.4"]
    assert run(arm, "timeout", "0.4", "--yes") == 0
    assert value(arm, capsys, "joint_1", "TIMEOUT") == 8000
    assert writes(arm) == {name: 2 if name == "joint_1" else 0 for name in writes(arm)}


# dumps


def test_an_arm_is_dumped_compared_and_restored(arm, capsys, tmp_path):
    path = tmp_path / "left.yaml"
    assert run(arm, "dump", path) == 0
    assert len(yaml.safe_load(path.read_text())["motors"]) == 7
    arm.fault("only", "joint_4", "silent")
    assert run(arm, "dump", tmp_path / "six.yaml") == 0
    assert "note: without joint_4: no answer" in capsys.readouterr().err
    arm.fault("only", "joint_4", "silent", False)
    assert run(arm, "diff", path) == 0
    assert "the motors hold what" in capsys.readouterr().err
    assert run(arm, "write", "OT_VALUE=90", "--motor", "joint_3,gripper", "--store", "--yes") == 0
    assert run(arm, "diff", path) == 1
    assert [line.split() for line in capsys.readouterr().out.splitlines()[1:]] == [
        ["joint_3", "OT_VALUE", "100.0", "90.0"],
        ["gripper", "OT_VALUE", "100.0", "90.0"],
    ]
    assert run(arm, "restore", path, "--yes") == 0
    cycle(arm)
    assert run(arm, "diff", path) == 0
    before = writes(arm)
    assert run(arm, "restore", path, "--yes") == 0
    assert "hold that already" in capsys.readouterr().err and writes(arm) == before


def test_a_dump_of_another_arm_or_a_broken_one_is_not_restored(arm, capsys, tmp_path):
    path = tmp_path / "left.yaml"
    assert run(arm, "dump", path) == 0
    good = yaml.safe_load(path.read_text())

    def with_changes(motor, **registers):
        path.write_text(yaml.safe_dump(good | {"motors": {motor: good["motors"].get(motor, {}) | registers}}))
        return refused(arm, capsys, "restore", path, "--yes")

    assert "motor of another type than in" in with_changes(1, GR=48.0)
    assert "expected a CAN id from 1 to 15" in with_changes(22)
    assert "expected a number, found 'hot'" in with_changes(1, OT_VALUE="hot")
    assert "no register 'WARMTH'" in with_changes(1, WARMTH=1)
    assert "ESC_ID: it is not 1; change ids with yam-motors set-id" in with_changes(1, ESC_ID=2)
    assert "motor 11 (id 11) does not answer" in with_changes(11, OT_VALUE=90)
    assert "OT_VALUE takes values from 80" in with_changes(1, OT_VALUE=20)
    assert "the time-out is 214748 s: give seconds, 0.05 to 10" in with_changes(1, TIMEOUT=2**32 - 1)
    path.write_text("version: 9\n")
    assert "is no dump of motors of version 1" in refused(arm, capsys, "restore", path, "--yes")


def test_restore_leaves_ids_and_read_only_registers(arm, capsys, tmp_path):
    path = tmp_path / "left.yaml"
    assert run(arm, "dump", path, "--motor", "joint_1") == 0
    document = yaml.safe_load(path.read_text())
    document["motors"][1] |= {"MST_ID": 30, "SN": 5, "OT_VALUE": 90, "TIMEOUT": 0}
    path.write_text(yaml.safe_dump(document))
    assert run(arm, "restore", path, "--yes") == 0
    said = capsys.readouterr().err
    assert "MST_ID differs and stays as it is: change it with yam-motors set-id" in said
    assert "HAZARD: without a time-out" in said
    assert "SN differs and stays as it is: it is read-only" in said
    with can.Bus(interface="yam_lockstep", channel="only", rig=arm.name) as bus:
        bus.send(can.Message(arbitration_id=0x7FF, data=encode_read(1, Register.OT_VALUE), is_extended_id=False))
        assert bus.recv(1.0).arbitration_id == 17
    assert value(arm, capsys, "joint_1", "OT_VALUE") == 90.0
