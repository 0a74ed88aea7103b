"""Answers that tell another state than the motor's, at the end of a frame's range too. The motor itself is well."""

import numpy as np
import pytest

from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.errors import ConfigError
from tests.support.rig_desk import Desk

CHANNEL = "follower_left"
SHOULDER, WRIST = 2, 6
LSB = 25.0 / 65535


@pytest.fixture
def desk():
    desk = Desk(friction=0)
    yield desk
    desk.close()


def lie(desk, can_id, value):
    desk.fault(CHANNEL, can_id, "reading", value)


def test_offsets_are_in_joint_sign():
    desk = Desk("follower_left")
    motor = desk.motor(SHOULDER)
    before = desk.special(SHOULDER, SpecialCommand.DISABLE).position
    lie(desk, SHOULDER, {"position_rad": 0.5})
    told = desk.special(SHOULDER, SpecialCommand.DISABLE).position
    direction = np.sign(motor.motor_angle_rad - motor.zero_rad) * np.sign(motor.drive.angle()) or 1.0
    assert told - before == pytest.approx(0.5 * direction, abs=2 * LSB)
    desk.close()


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
    assert told.position == pytest.approx(-12.0, abs=2 * LSB)
    assert (told.velocity, told.torque) == pytest.approx((-30.0, 10.0))
    lie(desk, WRIST, {"position_rad": -2 * np.pi - 12.0 - true})
    assert desk.mit(WRIST).position == pytest.approx(25.0 - 2 * np.pi - 12.0, abs=2 * LSB)


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
    ("value", "text"),
    [
        (True, "expected maybe position_rad, .*, or false"),
        ({"angle": 1.0}, "expected maybe position_rad"),
        ({"position_rad": float("nan")}, "finite"),
        ({"answers": 1.5}, "whole number"),
        ({"freeze": 1}, "true or false"),
    ],
)
def test_a_lie_that_makes_no_sense_is_refused(desk, value, text):
    with pytest.raises(ConfigError, match=text):
        lie(desk, WRIST, value)
