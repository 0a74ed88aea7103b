"""Faults of single motors: on the wire, of temperature, mechanics and readings. Real physics, no real time."""

import numpy as np
import pytest

from lerobot_robot_yam.damiao import codec, registers
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.simulation.fault_operations import KINDS
from tests.support.rig_desk import Desk

SHOULDER, WRIST = 2, 6
LSB_RAD = 25.0 / 65535  # of a position in an answer


def fault(desk, motor, kind, value=True, **details):
    desk.fault("follower_left", motor, kind, value, **details)


def clear(desk):
    desk.clear_faults("follower_left")


def refresh(desk, can_id):
    return desk.send((0x7FF, registers.encode_refresh(can_id)))


def test_a_wrong_identifier_is_of_the_link_and_not_in_the_registers(desk):
    fault(desk, "joint_3", "wrong_id", 0x15)
    (answer,) = refresh(desk, 3)
    assert (answer.id, codec.decode_feedback("DM4340", answer.data).motor_id) == (0x15, 3)
    (answer,) = desk.send((0x7FF, registers.encode_read(3, Register.MST_ID)))
    assert (answer.id, registers.decode_reply(answer.data).value) == (0x15, 0x13)
    assert refresh(desk, 4)[0].id == 0x14
    fault(desk, "joint_3", "wrong_id", False)
    assert refresh(desk, 3)[0].id == 0x13


@pytest.mark.parametrize(
    ("motor", "kind", "value"), [("joint_2", "silent", True), (2, "drop_next", 1), (None, "cable_out", True)]
)
def test_no_answer_comes_until_the_fault_is_cleared(desk, motor, kind, value):
    fault(desk, motor, kind, value)
    assert refresh(desk, 2) == []
    clear(desk)
    assert refresh(desk, 2) != []


def garbled(seed, all_bytes):
    desk = Desk(seed=seed)
    sound = refresh(desk, 2)[0].data
    fault(desk, 2, "corrupt_rate", 0.5, all_bytes=all_bytes)
    frames = []
    for _ in range(300):
        desk.now_s += 0.001  # the wire needs its time
        frames.append(refresh(desk, 2)[0].data)
    desk.close()
    return sound, frames


@pytest.mark.parametrize("all_bytes", [False, True])
def test_a_share_of_answers_is_garbled_and_the_same_ones_for_the_same_seed(all_bytes):
    sound, frames = garbled(1, all_bytes)
    wrong = [data for data in frames if data[1:6] != sound[1:6]]
    assert 100 < len(wrong) < 200
    assert all(len(data) == 8 for data in frames)
    assert (len({data[0] for data in wrong}) > 10) == all_bytes
    assert np.ptp([codec.decode_feedback("DM4340", data).position for data in wrong]) > 10
    assert garbled(1, all_bytes)[1] == frames
    assert garbled(2, all_bytes)[1] != frames


@pytest.mark.parametrize(
    ("limit_c", "register_c", "code"),
    [(80.0, 80.0, Fault.MOS_OVER_TEMPERATURE), (100.0, 120.0, Fault.ROTOR_OVER_TEMPERATURE)],
)
def test_a_motor_that_gets_too_hot_switches_itself_off(desk, limit_c, register_c, code):
    desk.special(WRIST, SpecialCommand.ENABLE)
    fault(desk, WRIST, "register", register_c, register=Register.OT_VALUE)
    fault(desk, WRIST, "temperature_ramp", {"rate_c_per_s": 100.0, "from_c": limit_c - 20})
    temperatures = []
    for _ in range(40):
        desk.run(0.01)
        feedback = desk.mit(WRIST, q=0.5, kp=5, kd=1)
        temperatures.append(feedback.temp_mos)
        if feedback.fault != Fault.NORMAL:
            break
    assert feedback.fault == code
    assert temperatures[0] == pytest.approx(limit_c - 19, abs=2)
    assert temperatures[-1] == pytest.approx(limit_c, abs=2)
    desk.run(0.01)
    assert desk.motor(WRIST).torque_nm == 0
    assert [e["fault"] for e in desk.device.events.since(0, 100) if e["kind"] == "motor_fault"] == [code]


def test_a_hot_motor_trips_again_until_it_has_cooled(desk):
    fault(desk, WRIST, "register", 80.0, register=Register.OT_VALUE)
    fault(desk, WRIST, "temperature_ramp", {"rate_c_per_s": -100.0, "from_c": 90.0})
    desk.run(0.02)
    assert desk.special(WRIST, SpecialCommand.CLEAR).fault == Fault.DISABLED
    desk.run(0.02)
    assert desk.special(WRIST, SpecialCommand.ENABLE).fault == Fault.MOS_OVER_TEMPERATURE
    desk.run(0.2)
    desk.special(WRIST, SpecialCommand.CLEAR)
    desk.run(0.02)
    assert desk.special(WRIST, SpecialCommand.ENABLE).fault == Fault.NORMAL


def test_sensors_that_lie_trip_nothing(desk):
    desk.special(WRIST, SpecialCommand.ENABLE)
    fault(desk, WRIST, "temperatures_c", [120, 130])
    desk.run(0.05)
    feedback = desk.mit(WRIST)
    assert (feedback.temp_mos, feedback.temp_rotor, feedback.fault) == (120, 130, Fault.NORMAL)
    fault(desk, WRIST, "temperatures_c", False)
    assert desk.mit(WRIST).temp_mos < 60


def settled(desk, can_id, **command):
    for _ in range(150):
        feedback = desk.mit(can_id, **command)
        desk.run(0.01)
    return feedback


@pytest.mark.parametrize(("can_id", "bias_nm"), [(WRIST, 1.0), (WRIST, -0.5), (7, 0.2)])
def test_a_torque_bias_displaces_a_held_joint_and_is_not_reported(desk, can_id, bias_nm):
    kp = 10.0
    desk.special(can_id, SpecialCommand.ENABLE)
    middle = settled(desk, can_id, q=desk.mit(can_id).position - 1.0 * (can_id == 7), kp=kp, kd=1).position
    fault(desk, can_id, "torque_bias_nm", bias_nm)
    pushed = settled(desk, can_id, q=middle, kp=kp, kd=1)
    assert pushed.position - middle == pytest.approx(bias_nm / kp, abs=0.015)
    assert pushed.torque == pytest.approx(-bias_nm, abs=0.1)  # the motor reports what it exerts against it
    clear(desk)
    assert settled(desk, can_id, q=middle, kp=kp, kd=1).position == pytest.approx(middle, abs=0.015)


def test_more_friction_holds_a_joint_against_less_torque(desk):
    desk.special(WRIST, SpecialCommand.ENABLE)
    fault(desk, WRIST, "friction_nm", 1.0)
    start = desk.mit(WRIST).position
    assert settled(desk, WRIST, tau=0.7).position == pytest.approx(start, abs=0.02)
    assert settled(desk, WRIST, tau=1.2).position > start + 0.5
    desk.device.world.set_pose("follower_left", np.zeros(6))
    clear(desk)
    for _ in range(15):
        feedback = desk.mit(WRIST, tau=0.7)
        desk.run(0.01)
    assert feedback.position > 0.1


def test_a_sticky_fault_survives_clear_until_repaired(desk):
    fault(desk, WRIST, "nibble", int(Fault.OVERLOAD), sticky=True)
    assert desk.special(WRIST, SpecialCommand.CLEAR).fault == Fault.OVERLOAD
    clear(desk)
    assert desk.special(WRIST, SpecialCommand.CLEAR).fault == Fault.DISABLED


def test_clearing_ends_every_fault_of_its_motors(desk):
    settings = {
        "silent": True,
        "drop_next": 5,
        "loss_rate": 1.0,
        "command_loss_rate": 1.0,
        "wrong_id": 0x77,
        "corrupt_rate": 1.0,
        "reading": {"position_rad": 1.0},
        "temperatures_c": [99, 99],
        "temperature_ramp": {"rate_c_per_s": 0, "from_c": 99},
        "torque_bias_nm": 1.0,
        "stuck": True,
        "friction_nm": 1.0,
    }
    model, data = desk.device.world.model, desk.device.world.data
    before = model.dof_damping.copy(), model.dof_frictionloss.copy(), model.dof_solimp.copy()
    for kind, value in settings.items():
        fault(desk, None, kind, value)
    assert refresh(desk, 1) == []
    fault(desk, None, "duplicate")
    assert len(refresh(desk, 1)) == 1  # the other one's
    clear(desk)
    (answer,) = refresh(desk, 1)
    feedback = codec.decode_feedback("DM4340", answer.data)
    assert feedback.temp_mos < 60 and feedback.fault == Fault.DISABLED
    after = model.dof_damping, model.dof_frictionloss, model.dof_solimp
    assert all((now == then).all() for now, then in zip(after, before, strict=True))
    assert not data.qfrc_applied.any()
    assert desk.device.events.since(0, 100)[-1]["kind"] == "faults_cleared"


def lie(desk, can_id, value):
    fault(desk, can_id, "reading", value)


def test_offsets_are_in_joint_sign(desk):
    motor = desk.motor(SHOULDER)
    before = desk.special(SHOULDER, SpecialCommand.DISABLE).position
    lie(desk, SHOULDER, {"position_rad": 0.5})
    told = desk.special(SHOULDER, SpecialCommand.DISABLE).position
    direction = np.sign(motor.motor_angle_rad - motor.zero_rad) * np.sign(motor.drive.angle()) or 1.0
    assert told - before == pytest.approx(0.5 * direction, abs=2 * LSB_RAD)


def test_only_the_given_number_of_answers_lies(desk):
    true = desk.special(WRIST, SpecialCommand.ENABLE).position
    lie(desk, WRIST, {"position_rad": 12.0, "answers": 2})
    told = [desk.mit(WRIST).position for _ in range(4)]
    assert np.round(np.subtract(told, true)).tolist() == [12, 12, 0, 0]


def test_a_position_beyond_the_range_comes_in_at_the_other_end_and_other_values_stay_at_theirs(desk):
    """As of a motor that truly stands there."""
    true = desk.special(WRIST, SpecialCommand.ENABLE).position
    lie(desk, WRIST, {"position_rad": 13.0 - true, "velocity_rad_s": -100.0, "torque_nm": 100.0})
    told = desk.mit(WRIST)
    assert told.position == pytest.approx(-12.0, abs=2 * LSB_RAD)
    assert (told.velocity, told.torque) == pytest.approx((-30.0, 10.0))
    lie(desk, WRIST, {"position_rad": -2 * np.pi - 12.0 - true})
    assert desk.mit(WRIST).position == pytest.approx(25.0 - 2 * np.pi - 12.0, abs=2 * LSB_RAD)


def test_a_frozen_reading_repeats_itself_while_the_joint_turns(desk):
    desk.special(WRIST, SpecialCommand.ENABLE)
    desk.mit(WRIST, tau=0.5, kd=0.05)
    desk.run(0.1)
    lie(desk, WRIST, {"freeze": True})
    before = desk.motor(WRIST).motor_angle_rad
    told = []
    for _ in range(20):
        told.append(desk.mit(WRIST, tau=0.5, kd=0.05))
        desk.run(0.01)
    assert len({(f.position, f.velocity, f.torque) for f in told}) == 1
    assert told[0].position == pytest.approx(before, abs=0.005) and told[0].velocity > 0.1
    assert desk.motor(WRIST).motor_angle_rad > before + 0.3
    lie(desk, WRIST, False)
    assert desk.mit(WRIST).position > before + 0.3


@pytest.mark.parametrize(
    ("motor", "kind", "value", "text"),
    [
        (1, "rust", True, "no fault kind 'rust'; known: silent, .*link_down"),
        (1, "link_down", True, "whole channel"),
        (None, "link_down", 1, "true or false"),
        (None, "handle_silent", True, "no teaching handle"),
        (None, "foreign", True, "expected {id, rate_hz}"),
        (None, "foreign", {"id": 1, "rate_hz": 0}, "from 0.01"),
        (None, "foreign", {"id": 1, "rate_hz": 10, "payload": "rock"}, "payload must be one of"),
        (9, "silent", True, "no motor 9"),
        (1, "silent", "yes", "true or false"),
        (1, "drop_next", 1.5, "whole number"),
        (1, "loss_rate", 1.5, "from 0.0 to 1.0"),
        (1, "corrupt_rate", float("nan"), "finite"),
        (1, "wrong_id", 0x800, "whole number from 0 to 2047"),
        (1, "temperatures_c", [1], "2 finite numbers"),
        (1, "temperature_ramp", {"from_c": 1}, "rate_c_per_s"),
        (1, "torque_bias_nm", "much", "finite number"),
        (1, "nibble", 16, "from 0 to 15"),
        (1, "storing", "late", "a motor stores in one of the ways"),
        (1, "reading", True, "expected maybe position_rad, .*, or false"),
        (1, "reading", {"angle": 1.0}, "expected maybe position_rad"),
        (1, "reading", {"position_rad": float("nan")}, "finite"),
        (1, "reading", {"answers": 1.5}, "whole number"),
        (1, "reading", {"freeze": 1}, "true or false"),
    ],
)
def test_a_fault_that_makes_no_sense_is_refused(desk, motor, kind, value, text):
    with pytest.raises(ConfigError, match=text):
        fault(desk, motor, kind, value)
    assert refresh(desk, 1) != []
    assert [e["kind"] for e in desk.device.events.since(0, 100)] == []


def test_without_power_it_is_limp_and_silent(desk):
    desk.special(1, SpecialCommand.ENABLE)
    fault(desk, 1, "power", False)
    assert refresh(desk, 1) == [] and desk.motor(1).torque_nm == 0
    fault(desk, 1, "power", True)
    assert desk.mit(1).fault == Fault.DISABLED


def test_every_kind_is_documented():
    from lerobot_robot_yam.rig.simulation.rig_operations import RigOperations

    for kind in KINDS:
        assert f'"{kind}"' in RigOperations.fault.__doc__, kind
