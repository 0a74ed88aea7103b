"""What a joint can have done between two readings, and what it cannot."""

import pytest

from lerobot_robot_yam.damiao.plausibility import Plausibility
from lerobot_robot_yam.damiao.tables import motor_type

TICK_S = 0.004
WRIST = "DM4310"


@pytest.fixture
def judge():
    """Of one wrist joint that has answered for ten ticks, at rest at 0 rad."""
    judge = Plausibility([motor_type(WRIST)], [False])
    for tick in range(10):
        assert answer(judge, tick * TICK_S, 0.0, 0.0)
    return judge


def answer(judge, at_s, q, dq, latest_s=0.0005, arrived_s=0.001):
    """Whether an answer is believed. By default the adapter takes next to no time."""
    return judge.accept(0, q, dq, at_s + 0.0003, at_s + latest_s, at_s, at_s + arrived_s)


def after(silence_s):
    """When the first answer comes after a silence, s."""
    return 9 * TICK_S + silence_s


def test_readings_that_agree_with_each_other_but_with_no_joint_are_refused(judge):
    """They stand still, and say that they move fast, through an adapter that takes a while."""
    times_s = [after((i + 1) * TICK_S) for i in range(20)]
    assert not any(answer(judge, at_s, -0.115, -7.25, latest_s=0.001, arrived_s=0.009) for at_s in times_s)
    assert judge.distrusted == [True]


def test_a_hand_may_snatch_at_a_joint_while_the_loop_stands_still(judge):
    assert not answer(judge, after(0.056), 0.25, 1.0)
    assert answer(judge, after(0.060), 0.254, 1.0)
    assert judge.distrusted == [False]


def test_no_hand_turns_a_joint_by_a_radian_while_a_cable_is_out(judge):
    assert not answer(judge, after(0.2), 0.93, 0.0)
    assert not answer(judge, after(0.204), 0.93, 0.0)


def test_no_time_that_an_adapter_takes_explains_any_jump(judge):
    """Two answers that agree, through an adapter that may have taken a fifth of a second."""
    for tick in (1, 2):
        assert not answer(judge, after(tick * TICK_S), 1.833, 25.5, latest_s=0.1, arrived_s=0.2)


@pytest.mark.parametrize("dq", [0.0, 25.0])
def test_the_first_answer_is_believed_whatever_it_says(judge, dq):
    """A limp arm that is armed again may be falling."""
    judge.restart([0])
    assert answer(judge, after(TICK_S), 1.5, dq)
    assert answer(judge, after(2 * TICK_S), 1.5 + dq * TICK_S, dq)
