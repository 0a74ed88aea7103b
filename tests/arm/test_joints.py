import math

import numpy as np
import pytest

from lerobot_robot_yam.arm.joints import TURN, JointMap, resolve_turn
from lerobot_robot_yam.arm.lifecycle import TRANSITIONS, Mode, check_transition
from lerobot_robot_yam.errors import LifeCycleError, MotorError


@pytest.mark.parametrize("true", [0.0, -0.1, 1.7, 3.66])
@pytest.mark.parametrize("turns", [-2, -1, 0, 1])
def test_the_turn_is_resolved_against_the_range(true, turns):
    assert resolve_turn("left", "joint_2", true - turns * TURN, 0.0, 3.66519) == pytest.approx(turns * TURN)


def test_a_reading_outside_every_turn_is_refused_by_name():
    with pytest.raises(MotorError, match="left: joint_2 reads -1.0"):
        resolve_turn("left", "joint_2", -1.0, 0.0, 3.66519)


def test_an_ambiguous_reading_is_refused():
    with pytest.raises(MotorError, match="2 turns"):
        resolve_turn("left", "joint_1", math.pi, -math.pi, math.pi)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_shift_moves_the_joint_angle_whatever_the_direction(direction):
    """The maker's own correction ignores the direction and moves a reversed motor the wrong way."""
    joints = JointMap(np.array([direction]), np.array([0.3]))
    motor = np.array([1.1])
    before = joints.position(motor)
    joints.shift(0, TURN)
    assert joints.position(motor) == pytest.approx(before + TURN)


def test_commands_are_the_inverse_of_positions():
    joints = JointMap(np.array([1.0, -1.0]), np.array([0.2, -0.4]))
    command = np.array([[0.5, 0.1, 80.0, 5.0, 1.0], [0.7, -0.2, 10.0, 1.5, -2.0]])
    sent = joints.commands(command)
    assert joints.position(sent[:, 0]) == pytest.approx(command[:, 0])
    assert sent[:, 1] == pytest.approx([0.1, 0.2])
    assert sent[:, 4] == pytest.approx([1.0, 2.0])


def test_torque_is_cut_only_when_landing_or_before_anything_was_energised_or_when_a_motor_failed():
    assert {mode for mode, following in TRANSITIONS.items() if Mode.OFF in following} == {
        Mode.OFFLINE,
        Mode.LAND,
        Mode.FAULT,
    }
    with pytest.raises(LifeCycleError, match="left: cannot go from hold to off"):
        check_transition("left", Mode.HOLD, Mode.OFF)


def test_a_landing_cannot_be_called_off():
    with pytest.raises(LifeCycleError, match="left: cannot go from land to hold"):
        check_transition("left", Mode.LAND, Mode.HOLD)
