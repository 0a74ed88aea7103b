"""What the console's keys do to the command of a motor."""

import pytest

from lerobot_robot_yam.commands.lib.motor.motor_knob import DOWN, LEFT, RIGHT, SPEED_RAD_S, UP, Knob
from lerobot_robot_yam.damiao.codec import decode_mit

STEP_RAD = 25.0 / 65535


def knob(**fields):
    return Knob("DM4310", **{"start_rad": 1.0, "range_rad": 0.5, "torque_nm": 3.0} | fields)


def press(knob, *keys):
    for key in keys:
        knob.press(key)


def asked(knob, q=1.0, elapsed_s=0.01):
    return decode_mit("DM4310", knob.command(q, elapsed_s))


def test_at_first_it_asks_the_motor_to_stay():
    assert asked(knob()).position == pytest.approx(1.0, abs=STEP_RAD)


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
    press(turned, " ")
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
