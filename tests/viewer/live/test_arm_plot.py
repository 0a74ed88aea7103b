"""What a plot of an arm shows: the last ten seconds, as far as they were read, whole rows alone."""

import numpy as np
import pytest

from lerobot_robot_yam.state.arm_state import ArmState
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import STATE_DTYPE
from lerobot_robot_yam.viewer.live.arm_panel import ArmHistory

N = 7


def state(tick, **fields):
    """Of an arm of six joints and a gripper, at 250 ticks a second."""
    record = np.zeros((), STATE_DTYPE)
    record["mode"], record["joints"], record["motors"] = Mode.TRACK, 6, N
    record["tick"], record["stamp_s"] = tick, 0.004 * tick
    record["motor_stamp_s"][:N] = 0.004 * tick - 0.0015
    record["action"] = np.nan
    for name, value in fields.items():
        record[name][: len(value)] = value
    return ArmState(record.tobytes())


def test_rows_are_what_the_states_said():
    history = ArmHistory(N)
    history.add(state(0))
    history.add(state(10, q=[0.1] * N, setpoint=[0.2] * N, action=[0.3] * N, tau=[4.0] * N))
    times, q, setpoint, target, torque, period, age = history.columns(
        1.04, 2, N + 2, 2 * N + 2, 3 * N + 6, 4 * N, 4 * N + 1
    )
    assert times == pytest.approx([-1.0])
    assert [*q, *setpoint, *target, *torque] == pytest.approx([0.1, 0.2, 0.3, 4.0])
    assert period == pytest.approx([4.0]) and age == pytest.approx([1.5])


def test_without_a_target_the_set_point_stands_for_it():
    history = ArmHistory(N)
    history.add(state(0))
    history.add(state(1, setpoint=[0.2] * N))
    history.add(state(2, setpoint=[0.2] * N, action=[0.5] * (N + 1)))  # a leader's, for a follower with a gripper more
    assert history.columns(0.0, 2 * N)[1] == pytest.approx([0.2, 0.2])


def test_a_state_read_twice_counts_once_and_one_without_a_reading_not_at_all():
    history = ArmHistory(N)
    for tick in (0, 1, 1, 2):
        history.add(state(tick, q=[np.nan if tick == 2 else 0.0] * N))
    assert len(history.columns(0.01, 0)[0]) == 1


def test_older_than_ten_seconds_is_gone():
    history = ArmHistory(N)
    for tick in range(0, 250 * 40, 12):  # 20 a second, for longer than the ring
        history.add(state(tick, q=[tick] * N))
    times, q = history.columns(40.0, 0)
    assert -10.0 < times[0] < -9.9 and times[-1] > -0.1
    assert (np.diff(times) > 0).all() and (np.diff(q) == 12).all()
