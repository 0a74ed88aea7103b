"""Two motors with one identifier: both hear every frame, both answer, each from another state."""

import pytest

from lerobot_robot_yam.damiao import codec, registers
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.errors import ConfigError

CHANNEL = "follower_left"
WRIST, KIND = 6, "DM4310"


def fault(desk, motor, kind, value=True, **details):
    desk.fault(CHANNEL, motor, kind, value, **details)


def both(desk, data, can_id=WRIST):
    """The answers of the first and the second motor."""
    first, second = desk.send((can_id, data))
    assert first.id == second.id == can_id + 16 and second.stamp_s > first.stamp_s
    return [codec.decode_feedback(desk.motor(can_id).kind, answer.data) for answer in (first, second)]


def mit(q=0.0, dq=0.0, kp=0.0, kd=0.0, tau=0.0):
    return codec.encode_mit(KIND, q, dq, kp, kd, tau)


def seconds(desk):
    return desk.state()["arms"][CHANNEL]["second_motors"]


def test_each_motor_has_a_twin_that_answers_after_it(desk):
    fault(desk, None, "second_arm")
    for motor in desk.channel.motors:
        first, second = both(desk, SpecialCommand.DISABLE.value, motor.can_id)
        assert abs(second.position - first.position) == pytest.approx(0.3, abs=0.001)
    assert list(seconds(desk)) == [motor.name for motor in desk.channel.motors]
    fault(desk, None, "second_arm", False)
    assert len(desk.send((WRIST, SpecialCommand.DISABLE.value))) == 1
    assert not seconds(desk)


def test_it_is_limp_until_it_is_enabled_and_then_obeys(desk):
    fault(desk, None, "second_arm", {"q_rad": [0.1 * i for i in range(7)]})
    motor = desk.motor(WRIST)
    enabled, second = both(desk, mit())
    assert (enabled.fault, second.fault) == (Fault.DISABLED, Fault.DISABLED)
    assert abs(second.position) == pytest.approx(0.5, abs=0.001)
    motor.twin.fault, motor.fault = Fault.DISABLED, Fault.NORMAL  # only the first was on when they were put together
    before = second.position
    for _ in range(50):
        first, second = both(desk, mit(q=1.0, kp=10, kd=1))
        desk.run(0.01)
    assert (first.fault, second.fault) == (Fault.NORMAL, Fault.DISABLED)
    assert first.position == pytest.approx(1.0, abs=0.1)
    assert second.position == pytest.approx(before, abs=0.001)
    assert [s.fault for s in both(desk, SpecialCommand.ENABLE.value)] == [Fault.NORMAL] * 2
    assert seconds(desk)["joint_6"]["enabled"]
    speeds = []
    for _ in range(150):
        first, second = both(desk, mit(q=1.0, kp=10, kd=1))
        speeds.append(second.velocity)
        desk.run(0.01)
    assert second.position == pytest.approx(1.0, abs=0.01) and second.velocity == pytest.approx(0.0, abs=0.02)
    assert max(speeds) > 0.5
    kinds = [event["kind"] for event in desk.device.events.since(0, 100)]
    assert kinds.count("second_motor_enabled") == 1 and kinds.count("motor_enabled") == 0


def test_its_watchdog_is_its_own(desk):
    fault(desk, WRIST, "duplicate")
    both(desk, SpecialCommand.ENABLE.value)
    desk.run(0.5)
    assert seconds(desk)["joint_6"]["fault"] == Fault.COMMUNICATION_LOST
    assert [s.fault for s in both(desk, SpecialCommand.CLEAR.value)] == [Fault.DISABLED] * 2


def test_only_the_doubled_motor_is_doubled_and_a_silent_one_leaves_the_word_to_its_twin(desk):
    fault(desk, "joint_6", "duplicate")
    assert len(desk.send((5, SpecialCommand.DISABLE.value))) == 1
    fault(desk, "joint_6", "silent")
    (answer,) = desk.send((WRIST, SpecialCommand.DISABLE.value))
    first = desk.motor(WRIST).motor_angle_rad
    assert abs(codec.decode_feedback(KIND, answer.data).position - first) == pytest.approx(0.3, abs=0.001)


def test_registers_are_its_own(desk):
    fault(desk, WRIST, "duplicate")
    answers = desk.send((0x7FF, registers.encode_read(WRIST, Register.SN)))
    numbers = [registers.decode_reply(answer.data).value for answer in answers]
    assert len(set(numbers)) == 2
    fault(desk, WRIST, "register", 500, register=int(Register.TIMEOUT))  # of the first one
    answers = desk.send((0x7FF, registers.encode_read(WRIST, Register.TIMEOUT)))
    assert [registers.decode_reply(answer.data).value for answer in answers] == [500, 8000]


def test_poses_must_fit(desk):
    with pytest.raises(ConfigError, match="7 finite numbers"):
        fault(desk, None, "second_arm", {"q_rad": [0.0]})
    with pytest.raises(ConfigError, match="q_rad"):
        fault(desk, 1, "duplicate", 3)
    assert not seconds(desk)
