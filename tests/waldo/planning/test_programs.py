"""Programs of moves: the same commands give the same plans, and playing them at ticks ends where they say."""

import numpy as np
import pytest

from lerobot_robot_yam.arm.profile_files import ARMS, GRIPPERS
from lerobot_robot_yam.arm.tool_pose import rotation_vector
from lerobot_robot_yam.errors import PlanError
from lerobot_robot_yam.waldo.controller.status_report import axes_enabled, joints_enabled
from lerobot_robot_yam.waldo.poses import commanded, to_vector
from tests.support.waldo_desk import planner_of

MOVES = 5
FEW, MANY = pytest.param(10, id="few"), pytest.param(100, id="many", marks=pytest.mark.long)


def program(planner, seed):
    """Plans of random moves, one after the other: joints and lines, those that are refused left out."""
    draw, q, plans = np.random.default_rng(seed), planner.home_q, []
    while len(plans) < MOVES:
        shares = {"speed": draw.uniform(0.1, 1.0), "accel": draw.uniform(0.2, 1.0)}
        way = np.concatenate([draw.uniform(-60, 60, 3), draw.uniform(-15, 15, 3)])
        joints = q + draw.uniform(-0.5, 0.5, len(q))
        try:
            if draw.random() < 0.5:
                plans.append(planner.joints(q, joints, **shares))
            else:
                plans.append(planner.line(q, commanded(planner.pose(q), way, "WRF", rel=True), **shares))
        except PlanError:
            continue
        q = plans[-1].q[-1]
    return plans


@pytest.mark.parametrize("count", [FEW, MANY])
def test_the_same_program_gives_the_same_plans(count):
    """The dry run and the controller plan on their own."""
    one, other = planner_of(), planner_of()
    for seed in range(count):
        for first, second in zip(program(one, seed), program(other, seed), strict=True):
            assert all(np.array_equal(*columns) for columns in zip(first, second, strict=True))


@pytest.mark.parametrize("count", [FEW, MANY])
@pytest.mark.parametrize("tick_s", [0.01, 0.0173])
def test_played_at_ticks_a_program_ends_where_its_plans_say(count, tick_s):
    planner = planner_of()
    for seed in range(count):
        for plan in program(planner, seed):
            played, _ = plan.at(np.arange(0.0, plan.duration_s + tick_s, tick_s))
            assert np.abs(played[-1] - plan.q[-1]).max() < np.radians(0.05)
            ends = planner.pose(np.array([played[-1], plan.q[-1]]))
            assert np.linalg.norm(ends[0, :3, 3] - ends[1, :3, 3]) < 5e-5
            steps = np.abs(np.diff(played, axis=0)) / tick_s
            assert (steps <= planner.limits.speed * 1.01).all()


@pytest.mark.parametrize("arm", ARMS)
@pytest.mark.parametrize("gripper", GRIPPERS)
def test_home_is_a_good_place_to_start_from(arm, gripper):
    """Away from every limit and from gimbal lock, every jog button open, lines of the usual sizes allowed."""
    planner = planner_of(arm, gripper)
    home = planner.home_q
    assert np.minimum(home - planner.lower, planner.upper - home).min() > np.radians(3.0)
    assert abs(to_vector(planner.pose(home))[4]) < np.radians(80.0)
    assert joints_enabled(planner, home).all()
    assert all(row.all() for row in axes_enabled(planner, home).values())
    for axis in range(3):
        for size in (-20.0, 20.0):
            way = size * np.eye(6)[axis]
            target = commanded(planner.pose(home), way, "WRF", rel=True)
            plan = planner.line(home, target, speed=0.5)
            poses = planner.pose(plan.at(np.linspace(0.0, plan.duration_s, 100))[0])
            off = np.delete(poses[:, :3, 3] - poses[0, :3, 3], axis, axis=1)
            turns = [rotation_vector(pose[:3, :3] @ poses[0, :3, :3].T) for pose in poses]
            assert np.abs(off).max() < 5e-4 and np.degrees(np.abs(turns).max()) < 0.3


def test_from_rest_home_is_a_move():
    planner = planner_of()
    rest = planner.hardware.rest_q - np.radians([0.0, 0.1, 0.1, 0.0, 0.0, 0.0])  # measured a little below the stops
    plan = planner.home(rest)
    assert np.array_equal(plan.q[-1], planner.home_q)
    assert (np.diff(plan.q[:, 1:3], axis=0) >= -1e-9).all()  # it leaves the stops and does not go back
