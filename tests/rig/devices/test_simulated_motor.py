"""Simulated motors, addressed by frames, on real physics but not in real time."""

import struct

import numpy as np
import pytest

from lerobot_robot_yam.damiao import codec, registers
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.damiao.tables import Fault, motor_type
from lerobot_robot_yam.errors import ConfigError
from tests.support.rig_desk import Desk

WRIST = 6  # carries no gravity torque to speak of: joint 6 turns about the tool's axis


def ask(desk, can_id, data):
    (answer,) = desk.send((0x7FF, data))
    assert answer.id == can_id + 16
    return answer


def test_a_motor_is_off_until_enabled_and_off_again(desk):
    assert desk.mit(WRIST, q=1, kp=10, kd=1).fault == Fault.DISABLED
    desk.run(0.1)
    assert desk.motor(WRIST).torque_nm == 0
    assert desk.special(WRIST, SpecialCommand.ENABLE).fault == Fault.NORMAL
    assert desk.special(WRIST, SpecialCommand.DISABLE).fault == Fault.DISABLED


def test_commands_take_the_wire_before_replies(desk):
    answers = desk.send(*((i, SpecialCommand.ENABLE.value) for i in range(1, 8)))
    assert [frame.id for frame in answers] == [0x10 + i for i in range(1, 8)]
    np.testing.assert_allclose(
        [frame.stamp_s - desk.now_s for frame in answers], [(7 + i) * 130e-6 for i in range(1, 8)], atol=1e-9
    )


def test_adapter_latency_counts_both_ways():
    desk = Desk(latency_s=0.00025)
    (answer,) = desk.send((1, SpecialCommand.ENABLE.value))
    assert answer.stamp_s == pytest.approx(desk.now_s + 0.0005 + 2 * 130e-6)
    desk.close()


def test_an_mit_command_moves_the_joint_and_is_reported(desk):
    desk.special(WRIST, SpecialCommand.ENABLE)
    for _ in range(100):
        feedback = desk.mit(WRIST, q=0.4, kp=10, kd=1)
        desk.run(0.01)
    true = desk.device.world.qpos[desk.device.world.joint_addresses("follower_left")[5]]
    assert true == pytest.approx(0.4, abs=0.01)
    assert feedback.position == pytest.approx(true, abs=1e-3)


def test_the_watchdog_lets_go_after_400_ms_of_silence_and_clear_then_enable_recovers(desk):
    desk.special(WRIST, SpecialCommand.ENABLE)
    desk.mit(WRIST, q=0.3, kp=10, kd=1)
    desk.run(0.39)
    assert desk.motor(WRIST).enabled
    desk.run(0.02)
    assert desk.motor(WRIST).fault == Fault.COMMUNICATION_LOST
    assert desk.motor(WRIST).torque_nm == 0
    assert desk.special(WRIST, SpecialCommand.ENABLE).fault == Fault.COMMUNICATION_LOST
    assert desk.special(WRIST, SpecialCommand.CLEAR).fault == Fault.DISABLED
    assert desk.special(WRIST, SpecialCommand.ENABLE).fault == Fault.NORMAL
    kinds = [event["kind"] for event in desk.device.events.since(0, 100)]
    assert kinds == ["motor_enabled", "motor_fault", "motor_enabled"]


def test_register_polls_do_not_feed_the_watchdog(desk):
    desk.special(WRIST, SpecialCommand.ENABLE)
    for _ in range(12):
        ask(desk, WRIST, registers.encode_refresh(WRIST))
        desk.run(0.04)
    assert desk.motor(WRIST).fault == Fault.COMMUNICATION_LOST


def test_a_timeout_of_zero_disables_the_watchdog(desk):
    ask(desk, WRIST, registers.encode_write(WRIST, Register.TIMEOUT, 0))
    desk.special(WRIST, SpecialCommand.ENABLE)
    desk.run(1.0)
    assert desk.motor(WRIST).enabled


@pytest.mark.parametrize("can_id", [1, 4, 7])
def test_registers_as_delivered(desk, can_id):
    kind = motor_type(desk.motor(can_id).kind)
    expected = {
        Register.MST_ID: can_id + 16,
        Register.ESC_ID: can_id,
        Register.TIMEOUT: 8000,
        Register.CTRL_MODE: 1,
        Register.PMAX: kind.position_max_rad,
        Register.VMAX: kind.velocity_max_rad_s,
        Register.TMAX: kind.torque_max_nm,
    }
    for register, value in expected.items():
        reply = registers.decode_reply(ask(desk, can_id, registers.encode_read(can_id, register)).data)
        assert (reply.motor_id, reply.register, reply.value) == (can_id, register, value)


def test_a_read_only_register_stays(desk):
    before = desk.motor(1)._registers[Register.SW_VER]
    raw = struct.pack("<HBBI", 1, 0x55, Register.SW_VER, 7)
    reply = registers.decode_reply(ask(desk, 1, raw).data)
    assert reply.value == before != 7


def test_a_changed_range_scales_feedback(desk):
    ask(desk, 1, registers.encode_write(1, Register.PMAX, 25.0))
    desk.device.world.set_pose("follower_left", np.array([1.0, 0.5, 0.5, 0, 0, 0]))
    desk.device.world.refresh()
    answer = ask(desk, 1, registers.encode_refresh(1))
    # Decoded with the wrong range the angle is halved: the contradiction a bring-up check must find.
    assert codec.decode_feedback("DM4340", answer.data).position == pytest.approx(0.5, abs=1e-3)


def test_a_new_identifier_takes_effect(desk):
    ask(desk, 5, registers.encode_write(5, Register.ESC_ID, 9))
    assert desk.send((5, SpecialCommand.ENABLE.value)) == []
    (answer,) = desk.send((9, SpecialCommand.ENABLE.value))
    assert answer.id == 5 + 16  # MST_ID is a register of its own


def test_storing_zero_makes_the_present_angle_zero(desk):
    desk.device.world.set_pose("follower_left", np.array([0.7, 0, 0, 0, 0, 0]))
    desk.device.world.refresh()
    assert desk.special(1, SpecialCommand.DISABLE).position == pytest.approx(0.7, abs=1e-3)
    assert desk.special(1, SpecialCommand.ZERO).position == pytest.approx(0.0, abs=1e-3)


def test_an_angle_beyond_the_range_wraps_and_commands_mean_the_reported_turn(desk):
    motor = desk.motor(WRIST)
    motor.zero_rad = 14.0  # as if the encoder had counted up
    desk.special(WRIST, SpecialCommand.ENABLE)
    position = desk.mit(WRIST).position
    assert position == pytest.approx(14.0 - 25.0, abs=1e-3)
    for _ in range(60):
        desk.mit(WRIST, q=position + 0.3, kp=10, kd=1)
        desk.run(0.01)
    assert motor.motor_angle_rad == pytest.approx(14.3, abs=0.02)


def test_a_command_of_another_mode_is_not_obeyed(desk):
    desk.special(WRIST, SpecialCommand.ENABLE)
    desk.send((0x200 + WRIST, struct.pack("<ff", 2.0, 0.0)))
    desk.run(0.1)
    assert abs(desk.mit(WRIST).velocity) < 0.2


def test_the_gripper_motor_drives_both_fingers_between_its_stops(desk):
    _, gripper = desk.device.world.profiles["follower_left"]
    closed, opened = gripper.calibration.nominal_stops_rad
    desk.special(7, SpecialCommand.ENABLE)
    for torque, stop, opening in ((0.5, closed, 0.0), (-0.5, opened, 1.0)):
        for _ in range(150):
            feedback = desk.mit(7, tau=torque)
            desk.run(0.02)
        assert feedback.position == pytest.approx(stop, abs=0.05)
        assert desk.device.world.opening("follower_left") == pytest.approx(opening, abs=0.01)


@pytest.mark.parametrize(("arm", "gripper"), [("big_yam", "flexible_4310"), ("yam_pro", "linear_3507")])
def test_directions_and_offsets_of_other_hardware(arm, gripper):
    desk = Desk(arm=arm, gripper=gripper)
    world = desk.device.world
    profile, _ = world.profiles["follower_left"]
    pose = np.array([0.3, 0.5, 0.4, -0.2, 0.1, 0.2])
    world.set_pose("follower_left", pose)
    world.refresh()
    for motor, q in zip(profile.motors, pose, strict=True):
        position = desk.special(motor.can_id, SpecialCommand.DISABLE).position
        assert position * motor.direction == pytest.approx(q, abs=1e-3)
    desk.close()


def test_a_flooded_bus_loses_frames_instead_of_queueing_for_ever(desk):
    flood = [(1, SpecialCommand.ENABLE.value)] * 400
    assert len(desk.send(*flood)) == 400
    assert desk.send(*flood) == []
    assert desk.channel.overflows == 1


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_an_impossible_range_is_not_taken(desk, value):
    raw = struct.pack("<HBBf", 1, 0x55, Register.PMAX, value)
    assert registers.decode_reply(ask(desk, 1, raw).data).value == 12.5


def test_an_unknown_register_cannot_be_set(desk):
    with pytest.raises(ConfigError, match="no register 99"):
        desk.motor(1).set_register(99, 1.0)
