"""yam-zero on the rig: limp motors take their angle as zero, those alone, and only when nothing speaks against it."""

import contextlib
import json
import os
import re
import sys
import threading
from pathlib import Path

import can
import numpy as np
import pytest
import yaml

from lerobot_robot_yam.arm import profile_files
from lerobot_robot_yam.arm.joint_map import TURN
from lerobot_robot_yam.arm.profile_files import ARMS, load_arm
from lerobot_robot_yam.commands.lib.arm_command import own_bus
from lerobot_robot_yam.commands.zero import Zeroing, main
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.errors import ConfigError, MotorError
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.session.yam_arm import YamArm
from tests.support import base_rig
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
    with YamArm(config(crooked), isolation="lockstep") as arm:
        difference = arm.observe().q - crooked.state()["arms"]["only"]["q"]
        assert np.abs(np.delete(difference, 3)).max() < 0.02
        assert difference[3] == pytest.approx(OFFSETS[3], abs=0.02)


def test_a_motor_on_another_turn_and_turned_round_is_zeroed(tmp_path):
    offsets = [0.0, TURN + 0.2, 0.0, 0.0, -TURN, 0.0]
    with contextlib.closing(LockstepRig(scene(tmp_path, offsets, "big_yam", "no_gripper"))) as rig:
        assert main(arguments(rig, "--arm", "big_yam", "--joint", "joint_2", "joint_5", "--yes")) == 0
        after = motor_rad(rig)
        assert abs(after["joint_2"]) < 0.005 and abs(after["joint_5"]) < 0.005


def test_a_leader_is_zeroed_too():
    with contextlib.closing(LockstepRig()) as rig:
        assert main(arguments(rig, "--joint", "joint_3", "--yes", channel="leader_left")) == 0


def test_an_unresolvable_joint_is_shown_and_can_be_zeroed(tmp_path, capsys):
    """The very case for which zeroing is advised."""
    with contextlib.closing(LockstepRig(scene(tmp_path, [3.4, 0, 0, 0, 0, 0, 0]))) as rig:
        with pytest.raises(MotorError, match="yam-zero --channel only .*--joint joint_1"):
            YamArm(config(rig), isolation="lockstep").connect()
        assert main(arguments(rig, "--joint", "joint_2", "--yes")) == 0
        said = capsys.readouterr()
        assert "unclear" in said.out and "note: only: joint_1 reads 3.4" in said.err
        assert main(arguments(rig, "--joint", "joint_1", "--yes")) == 0
        with YamArm(config(rig), isolation="lockstep") as arm:
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
    with open(os.devnull) as nothing:
        monkeypatch.setattr(sys, "stdin", nothing)
        assert "no terminal" in refused(crooked, capsys)[0]


def test_a_channel_in_use_is_left_alone(crooked, capsys):
    with own_bus(config(crooked)):
        assert "in use by process" in refused(crooked, capsys, "--yes")[0]


def test_an_energised_motor_refuses(crooked, capsys):
    """Enabled and left to itself, as after a crash; its watchdog gives up only after 20 s here."""
    crooked.fault("only", "gripper", "register", 400_000, register=int(Register.TIMEOUT))
    with open_bus(crooked) as bus:
        bus.send(frame(7, SpecialCommand.ENABLE))
        crooked.sleep(0.1)
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
        (["--joint", "joint_7", "--yes"], "no joint joint_7; it has joint_1, joint_2"),
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


def test_at_a_terminal_it_shows_the_angles_live_until_the_joints_are_placed(crooked, capsys, type_in):
    keys = type_in()
    person = threading.Timer(0.5, os.write, (keys, b"\nzero\n"))  # after the angles were shown twice
    person.start()
    assert main(arguments(crooked, "--joint", "joint_1")) == 0
    person.join()
    said = capsys.readouterr().err
    assert "motor rad: joint_1 +0.30" in said and "joint_1 (range -2.62 … +3.14 rad): base:" in said
    assert said.index("Press Enter") < said.index("motor rad: joint_1") < said.index("Type zero")
    assert abs(motor_rad(crooked)["joint_1"]) < 0.005


@pytest.mark.parametrize("answer", [b"yes\n", b"\n", b"\x04"])
def test_anything_but_the_word_zeroes_nothing(crooked, capsys, type_in, answer):
    type_in(b"\n" + answer)
    assert "nothing" in refused(crooked, capsys, "--joint", "joint_1")[0]


# when the bus or a motor does not play along


def frame(can_id, command):
    return can.Message(arbitration_id=can_id, data=command.value, is_extended_id=False)


def open_bus(rig):
    return can.Bus(interface="yam_lockstep", channel="only", rig=rig.name)


def looked_at(rig, bus, *joints):
    """Zeroing of joints that are limp and still."""
    zeroing = Zeroing(config(rig), bus, joints)
    zeroing.inspect()
    zeroing.require_still()
    return zeroing


def test_a_motor_that_is_enabled_behind_our_back_refuses(crooked):
    """The bus is our own, so the enable comes from the test: another computer could do the same."""
    with open_bus(crooked) as bus:
        zeroing = looked_at(crooked, bus, "joint_1")
        bus.send(frame(6, SpecialCommand.ENABLE))
        crooked.trace_start("only")
        with pytest.raises(MotorError, match=r"left \(only\): joint_6 energised; zeroing is for limp motors"):
            zeroing.set_zero()
        assert set(sent(crooked)) <= {6}


def test_a_hand_may_move_a_limp_joint_as_far_as_it_likes(crooked):
    with open_bus(crooked) as bus:
        zeroing = Zeroing(config(crooked), bus, ["joint_1"])
        zeroing.inspect()
        before = zeroing.read().motor_rad[0]
        crooked.set_pose("only", q=[1.2, 0.6, 0.6, 0.0, 0.0, 0.0])
        assert abs(zeroing.read().motor_rad[0] - before) > 1.0


class MeddlingBus:
    """A bus on which something is wrong with ZERO frames: `meddle` maps each one to what really goes out."""

    def __init__(self, bus, meddle, listens=lambda: None):
        self._bus, self._meddle, self._listens, self.clock = bus, meddle, listens, bus.clock

    def recv(self, timeout_s):
        self._listens()
        return self._bus.recv(timeout_s)

    def send(self, message):
        self.send_many([message])

    def send_many(self, messages):
        for message in messages:
            out = self._meddle(message) if bytes(message.data) == SpecialCommand.ZERO.value else [message]
            for one in out:
                self._bus.send(one)


@pytest.mark.parametrize(
    ("meddle", "message"),
    [
        (lambda sent: [], r"not zeroed: joint_1 reads 0.30. rad, joint_5 reads -0.* \(zeroed: none\)"),
        (lambda sent: [sent] if sent.arbitration_id == 1 else [], r"not zeroed: joint_5 .* \(zeroed: joint_1\)"),
        (
            lambda sent: [sent, frame(3, SpecialCommand.ZERO)],
            r"other motors changed too: joint_3 from 0.* to -?0.000 rad",
        ),
    ],
    ids=["lost", "one lost", "another motor listens"],
)
def test_a_zero_that_did_not_do_what_it_should_is_an_error(crooked, meddle, message):
    with open_bus(crooked) as bus:
        zeroing = looked_at(crooked, MeddlingBus(bus, meddle), "joint_5", "joint_1")
        with pytest.raises(MotorError, match=rf"left \(only\): .*{message}"):
            zeroing.set_zero()


@pytest.mark.parametrize("silent_s", [0.3, 60.0])
def test_a_motor_that_is_silent_while_it_writes_is_waited_for_and_then_named(crooked, silent_s):
    ends_s = []

    def fall_silent(frame):
        bus.send(frame)
        crooked.sleep(0.05)
        crooked.fault("only", "joint_1", "silent")
        ends_s.append(crooked.now() + silent_s)
        return []

    def speak_again():
        if ends_s and crooked.now() > ends_s[0]:
            crooked.clear_faults("only")

    with open_bus(crooked) as bus:
        zeroing = looked_at(crooked, MeddlingBus(bus, fall_silent, speak_again), "joint_1")
        refuses = pytest.raises(MotorError, match="zero was set, or not, of joint_1; then: .*no answer from joint_1")
        with contextlib.nullcontext() if silent_s < 1.0 else refuses:
            zeroing.set_zero()


def test_a_range_without_zero_is_refused(crooked, tmp_path):
    packaged = Path(profile_files.__file__).parent / "profiles" / "arms" / "yam.yaml"
    document = yaml.safe_load(packaged.read_text())
    document["joint_limits_rad"][1] = [0.5, 3.0]
    for rest in document["rest_q_rad"].values():
        rest[1] = 0.5
    (tmp_path / "odd.yaml").write_text(yaml.safe_dump(document))
    with open_bus(crooked) as bus:
        with pytest.raises(ConfigError, match="the range 0.50 … 3.00 of joint_2 does not hold 0"):
            Zeroing(config(crooked, arm=str(tmp_path / "odd.yaml")), bus, ["joint_2"])


def test_of_a_base_the_steering_is_zeroed_and_the_wheels_are_not(tmp_path, capsys):
    with contextlib.closing(LockstepRig(base_rig.scene(tmp_path, steer_zero_rad=[0.3, -0.2, 1.5, 0.0]))) as rig:
        rig.trace_start("base")
        assert main(base_rig.arguments(rig, "--joint", "front_left_drive", "--yes")) == 1
        assert "no joint front_left_drive; it has rear_left_steer, front_left_steer" in capsys.readouterr().err
        assert main(base_rig.arguments(rig, "--yes")) == 0
        said = capsys.readouterr()
        assert "front_right_steer by +1.50" in said.err and "its hub is 20 mm behind the steering axis" in said.err
        assert sent(rig, "base") == [1, 3, 5, 7]
        after = {name: motor["motor_rad"] for name, motor in base_rig.motors(rig).items()}
        assert max(abs(after[name]) for name in base_rig.STEER) < 0.005
        assert not events(rig, "motor_enabled")
