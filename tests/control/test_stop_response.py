"""The effort limit: torque above it for 50 ms, not a knock."""

import numpy as np

from lerobot_robot_yam.control.stop_response import EffortLimit

TICK_S = 0.004
NAMES = ["joint_1", "joint_2", "joint_3"]


def run(limit, torques, start=50.0):
    """Verdict after each tick."""
    watch = EffortLimit(np.array(limit), NAMES)
    return [watch.check(start + k * TICK_S, np.array(row)) for k, row in enumerate(torques)]


def test_a_lasting_excess_is_named_after_fifty_milliseconds():
    verdicts = run([10.0, 10.0, 10.0], [[1.0, -12.5, 3.0]] * 30)
    first = next(k for k, verdict in enumerate(verdicts) if verdict)
    assert 0.05 < first * TICK_S <= 0.05 + 2 * TICK_S
    assert all(verdicts[first:])
    said = "joint_2 works with -12.5 Nm beyond weight and motion, against its effort limit of 10.0 Nm"
    assert verdicts[first] == said


def test_knocks_are_forgiven_and_each_joint_counts_for_itself():
    knock = [[12.0, 0.0, 0.0]] * 12 + [[0.0, 0.0, 0.0]]
    assert not any(run([10.0, 10.0, 10.0], knock * 10))
    relay = ([[12.0, 0.0, 0.0]] * 8 + [[0.0, 12.0, 0.0]] * 8) * 10
    assert not any(run([10.0, 10.0, 10.0], relay))


def test_a_joint_without_limit_and_a_missing_reading_never_trip():
    assert not any(run([np.inf, 10.0, 10.0], [[500.0, np.nan, 1.0]] * 50))


def test_the_worst_joint_is_named():
    verdicts = run([10.0, 2.0, 10.0], [[12.0, 4.0, 0.0]] * 30)
    assert verdicts[-1] == "joint_2 works with 4.0 Nm beyond weight and motion, against its effort limit of 2.0 Nm"
