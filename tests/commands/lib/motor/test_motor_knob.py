"""What the console's keys do to the command of a motor."""

import pytest

from lerobot_robot_yam.commands.lib.motor.motor_knob import DOWN, LEFT, RIGHT, SPEED_RAD_S, UP, Knob
from lerobot_robot_yam.damiao.codec import decode_mit, decode_position_velocity
from lerobot_robot_yam.damiao.tables import ControlMode

STEP_RAD = 25.0 / 65535


def knob(mode=ControlMode.MIT, **fields):
    return Knob("DM4310", mode, **{"start_rad": 1.0, "range_rad": 0.5, "torque_nm": 3.0} | fields)


def press(knob, *keys, q=1.0):
    for key in keys:
        knob.press(key, q)


def asked(knob, q=1.0, elapsed_s=0.01):
    identifier, data = knob.frame(6, q, elapsed_s)
    assert identifier == 6
    return decode_mit("DM4310", data)


def test_at_first_it_asks_the_motor_to_stay():
    assert asked(knob()).position == pytest.approx(1.0, abs=STEP_RAD)
    assert knob(ControlMode.VELOCITY).frame(6, 1.0, 0.01) == (0x206, bytes(8))


def test_the_setpoint_goes_to_the_target_at_a_limited_speed():
    turned = knob()
    press(turned, RIGHT, RIGHT)
    assert asked(turned).position == pytest.approx(1.0 + SPEED_RAD_S * 0.01, abs=STEP_RAD)
    for _ in range(100):
        command = asked(turned, q=turned.setpoint_rad)
    assert command.position == pytest.approx(1.1, abs=STEP_RAD)


def test_a_motor_that_is_blocked_is_not_pushed_harder_than_allowed():
    turned = knob(kp=50.0, torque_nm=1.0)
    press(turned, *[RIGHT] * 10)
    for _ in range(500):
        command = asked(turned, q=1.0)
    assert command.kp * (command.position - 1.0) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(("key", "end"), [(LEFT, 0.5), (RIGHT, 1.5)])
def test_the_target_stays_within_the_range(key, end):
    turned = knob()
    press(turned, UP, UP, *[key] * 20)
    assert turned.target == end
    asked(turned)
    press(turned, " ", q=1.2)
    assert turned.target == turned.setpoint_rad == pytest.approx(1.0, abs=0.01)  # a load must not pull it along


def test_the_step_grows_and_shrinks_between_its_ends():
    turned = knob()
    press(turned, *[UP] * 9)
    assert turned.step == 0.2
    press(turned, *[DOWN] * 9)
    assert turned.step == 0.01


def test_gains_stay_within_reason():
    turned = knob()
    press(turned, *"K" * 50, *"D" * 50)
    assert (asked(turned).kp, asked(turned).kd) == (pytest.approx(100, abs=0.2), pytest.approx(5, abs=0.01))
    press(turned, *"k" * 50, *"d" * 50, "x")
    assert (turned.kp, turned.kd) == (1.0, 0.1)


def test_the_position_mode_sends_the_target_and_a_speed():
    turned = knob(ControlMode.POSITION_VELOCITY)
    press(turned, RIGHT)
    identifier, data = turned.frame(6, 1.0, 0.01)
    press(turned, " ", q=1.02)
    assert turned.target == 1.02
    assert identifier == 0x106 and decode_position_velocity(data) == pytest.approx((1.05, SPEED_RAD_S))


def test_the_velocity_mode_stops_at_the_end_of_the_range():
    turned = knob(ControlMode.VELOCITY)
    press(turned, *[RIGHT] * 50)

    def speed(q):
        return decode_position_velocity(turned.frame(6, q, 0.01)[1])[0]

    assert speed(1.4) == SPEED_RAD_S and speed(1.6) == 0.0
    press(turned, *[LEFT] * 50)
    assert speed(1.6) == -SPEED_RAD_S and speed(0.4) == 0.0
    press(turned, " ")
    assert speed(1.0) == 0.0
