"""Trajectories: what is refused before anything moves, and the ways between poses."""

import math

import numpy as np
import pytest

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.errors import ActionError
from lerobot_robot_yam.session.trajectory import Trajectory, columns_of, soft_way, soft_way_s

ARM = ResolvedArm(ArmConfig(name="left", channel="a"))
ROW = [0.0, 0.5, 0.5, 0.0, 0.0, 0.0, 0.5]


def of(rows, times=None, **fields):
    return Trajectory(np.arange(float(len(rows))) if times is None else times, np.array(rows), **fields)


@pytest.mark.parametrize(
    ("rows", "times", "said"),
    [
        ([ROW, [*ROW[:3], math.nan, *ROW[4:]]], None, "trajectory: row 1 has nan for column 3"),
        ([ROW, ROW, ROW], [0.0, 2.0, 1.0], "time goes back or stands still at row 2"),
        ([ROW, ROW], [3.0, 3.0], "time goes back or stands still at row 1"),
        ([ROW, ROW], [0.0, math.inf], "time 1 is no number"),
        ([ROW], [0.0], "2 or more times"),
        ([ROW, ROW], [0.0, 1.0, 2.0], "2 or more times"),
    ],
)
def test_what_is_no_trajectory_is_refused(rows, times, said):
    with pytest.raises(ActionError, match=said):
        of(rows, times)


def test_names_are_as_many_as_the_columns():
    with pytest.raises(ActionError, match=f"trajectory: 1 names for {len(ROW)} columns of positions"):
        of([ROW, ROW], columns=("joint_1",))


def test_what_the_arm_cannot_follow_is_refused_by_the_joints_name():
    of([ROW, ROW]).check([ARM])
    of([ROW, [*ROW[:1], -0.1, *ROW[2:]]]).check([ARM])  # measured at rest, a little outside of the limit
    with pytest.raises(ActionError, match=r"joint_2 is at -0\.300 in row 1, and takes 0\.00 … 3\.67; nothing moves"):
        of([ROW, [*ROW[:1], -0.3, *ROW[2:]]]).check([ARM])
    with pytest.raises(ActionError, match="gripper is at 1.200 in row 0"):
        of([[*ROW[:6], 1.2], ROW]).check([ARM])
    with pytest.raises(ActionError, match="has 7 columns, and left and left have 14"):
        of([ROW, ROW]).check([ARM, ARM])
    with pytest.raises(ActionError, match=r"is of other joints: it has 7 columns \(other, joint_2"):
        of([ROW, ROW], columns=("other", *columns_of([ARM])[1:])).check([ARM])


def test_it_is_straight_between_its_rows_and_rests_outside():
    path = of([[0.0, 1.0], [1.0, 3.0], [1.0, 0.0]], [5.0, 6.0, 8.0])
    assert path.seconds == 3.0
    np.testing.assert_allclose(
        [path.at(t) for t in (-1, 0, 0.25, 2, 9)], [[0, 1], [0, 1], [0.25, 1.5], [1, 1.5], [1, 0]]
    )


def test_it_is_slowed_only_where_it_is_too_quick():
    slow = of([[0.0], [1.0], [1.1]]).slowed(np.array([0.5]))
    np.testing.assert_allclose(slow.times_s, [0.0, 2.0, 3.0])


def test_a_soft_way_has_the_speed_and_the_acceleration_that_its_time_was_made_of():
    goal = np.array([0.4, -0.9])
    for speed, acceleration in ((np.array([1.0, 1.0]), math.inf), (np.array([9.0, 9.0]), 3.0)):
        seconds = soft_way_s(goal, speed, acceleration)
        path = soft_way(np.zeros(2), goal, seconds)
        rates = np.gradient(path.positions, path.times_s, axis=0)
        np.testing.assert_allclose(path.positions[-1], goal)
        fastest = np.abs(rates).max() / speed[0]
        hardest = np.abs(np.gradient(rates, path.times_s, axis=0)).max() / acceleration
        assert max(fastest, hardest) == pytest.approx(1.0, abs=0.05)
