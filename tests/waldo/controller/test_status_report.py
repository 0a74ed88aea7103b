"""Jog buttons are open where the arm can go, and shut where it cannot."""

import numpy as np
import pytest

from lerobot_robot_yam.waldo.controller.status_report import axes_enabled, joints_enabled
from lerobot_robot_yam.waldo.poses import commanded
from tests.support.waldo_desk import planner_of


@pytest.fixture(scope="module", params=["yam", "big_yam"])
def planner(request):
    return planner_of(request.param)


@pytest.mark.parametrize("joint", range(6))
def test_at_a_limit_only_the_way_back_is_open(planner, joint):
    for side, limits in enumerate((planner.upper, planner.lower)):
        q = planner.home_q.copy()
        q[joint] = limits[joint] + (-0.5, 0.5)[side] * np.radians(1.0)
        enabled = joints_enabled(planner, q).reshape(6, 2)
        assert enabled[joint].tolist() == ([0, 1] if side == 0 else [1, 0])
        assert enabled.sum() == 11


def test_with_the_shoulder_at_its_limit_some_axis_is_shut_and_some_open(planner):
    q = planner.home_q.copy()
    q[1] = planner.upper[1]
    for row in axes_enabled(planner, q).values():
        assert 0 < row.sum() < 12


def test_where_the_arm_would_have_to_turn_over_the_button_is_shut():
    """There are joints for the pose 5 mm away, but they are nearly 1 rad away."""
    planner = planner_of()
    q = np.array([1.88, 3.4, 0.47, 0.35, -1.12, -0.24])
    there = commanded(planner.pose(q), [5.0, 0, 0, 0, 0, 0], "WRF", rel=True)
    assert np.abs(planner.inverse(there, q) - q).max() > 0.6
    assert axes_enabled(planner, q)["WRF"][0] == 0
