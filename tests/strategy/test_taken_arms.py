"""Whose action each arm gets, and that nothing jumps when an arm goes over from one to the other."""

import numpy as np
import pytest

from lerobot_strategy_yam.take_over import TakenArms

SIDES = ("left_", "right_")


def action(left, right):
    return {"left_joint_1.pos": left, "right_joint_1.pos": right}


def test_each_arm_gets_the_action_of_who_drives_it():
    arms = TakenArms(SIDES, 0.0)
    assert arms.action(0.0, action(1.0, 2.0), None) == action(1.0, 2.0)
    arms.take("right_")
    assert arms.action(0.1, action(1.1, 2.1), action(8.0, 9.0)) == action(1.1, 9.0)
    arms.take("left_")
    assert arms.all_taken
    assert arms.action(0.2, None, action(8.1, 9.1)) == action(8.1, 9.1)
    arms.give_back("right_")
    assert not arms.all_taken
    assert arms.action(0.3, action(1.2, 2.2), action(8.2, 9.2)) == action(8.2, 2.2)


def test_one_arm_has_no_prefix():
    arms = TakenArms([""], 0.0)
    assert arms.action(0.0, {"gripper.pos": 1.0}, None) == {"gripper.pos": 1.0}
    arms.take("")
    assert arms.action(0.0, None, {"gripper.pos": 0.2}) == {"gripper.pos": 0.2}


def test_nothing_is_asked_for_before_the_policy_speaks_and_an_arm_stays_while_it_says_nothing():
    arms = TakenArms(SIDES, 0.5)
    assert arms.action(0.0, None, None) == {}
    arms.take("left_")
    assert arms.action(0.0, None, action(8.0, 9.0)) == {}
    assert arms.action(0.0, action(1.0, 2.0), action(8.0, 9.0)) == action(8.0, 2.0)
    arms.give_back("left_")
    assert arms.action(0.1, None, None) == action(8.0, 2.0)  # it is thinking


@pytest.mark.parametrize("wait_s", [0.0, 0.3])
def test_an_arm_that_is_given_back_blends_from_where_it_was_left_to_the_policy(wait_s):
    arms = TakenArms(SIDES, 0.5)
    arms.action(0.0, action(0.0, 0.0), None)
    arms.take("left_")
    arms.action(0.0, action(0.0, 0.0), action(1.0, 5.0))
    arms.give_back("left_")
    for now in np.arange(0.0, wait_s, 0.01):
        assert arms.action(now, None, None) == action(1.0, 0.0)
    seen = [arms.action(now, action(0.0, 0.0), None) for now in wait_s + np.arange(0.0, 0.7, 0.01)]
    left = np.array([one["left_joint_1.pos"] for one in seen])
    assert left[0] == 1.0 and np.abs(np.diff(left)).max() < 0.04 and left[25] == pytest.approx(0.5)
    assert np.all(left[50:] == 0.0)
    assert all(one["right_joint_1.pos"] == 0.0 for one in seen)


def test_an_arm_that_is_taken_over_while_it_blends_is_the_persons_at_once():
    arms = TakenArms(SIDES, 0.5)
    arms.resume(action(1.0, 1.0))
    assert arms.action(0.0, action(0.0, 0.0), None) == action(1.0, 1.0)
    arms.take("left_")
    assert arms.action(0.25, action(0.0, 0.0), action(3.0, 3.0)) == pytest.approx(action(3.0, 0.5))
