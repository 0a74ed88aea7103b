"""Straight lines of the tool: straight in the plan, within the limits, or refused before they start."""

import numpy as np
import pytest

from lerobot_robot_yam.arm.kinematics import pose_errors
from lerobot_robot_yam.arm.tool_pose import rotation_vector
from lerobot_robot_yam.errors import PlanError
from lerobot_robot_yam.waldo.planning.line_motion import STRAIGHT_M, STRAIGHT_RAD, Line
from lerobot_robot_yam.waldo.planning.motion_plan import Plan
from lerobot_robot_yam.waldo.poses import commanded
from tests.support.waldo_desk import planner_of

LOOKS = 400


def off_the_line(planner, plan, target):
    """How far the tool strays from the straight line to `target`, m, and how far it turns off it, rad."""
    poses = planner.pose(plan.at(np.linspace(0.0, plan.duration_s, LOOKS))[0])
    line = Line.between(poses[0], target)
    length, turn = line.size
    moved = poses[:, :3, 3] - line.start[:3, 3]
    turned = np.array([rotation_vector(pose[:3, :3] @ line.start[:3, :3].T) for pose in poses])
    shares = moved @ line.way / length**2 if length > 1e-6 else turned @ line.turn / turn**2
    rests = [pose_errors(pose, line.at(share))[1] for pose, share in zip(poses, shares, strict=True)]
    return np.linalg.norm(moved - np.outer(shares, line.way), axis=1).max(), max(rests)


@pytest.mark.parametrize(
    "way",
    [[0, 0, 20, 0, 0, 0], [100, 0, 0, 0, 0, 0], [0, -200, 0, 0, 0, 20], [0, 0, 0, 25, 0, 0], [-30, 80, -50, 10, 5, -8]],
)
@pytest.mark.parametrize("arm", ["yam", "big_yam"])
def test_the_tool_stays_on_the_line_and_ends_on_its_target(arm, way):
    planner = planner_of(arm)
    target = commanded(planner.pose(planner.home_q), way, "TRF")
    plan = planner.line(planner.home_q, target, speed=1.0)
    position, turn = off_the_line(planner, plan, target)
    assert position < 5e-4 and np.degrees(turn) < 0.3
    assert np.abs(planner.pose(plan.q[-1]) - target).max() < 1e-5
    assert np.abs(plan.dq).max() <= planner.limits.speed.max() * 1.001
    assert np.abs(plan.dq[[0, -1]]).max() < 1e-6
    assert (plan.q >= planner.lower).all() and (plan.q <= planner.upper).all()


def test_many_lines_are_straight_or_refused_at_once():
    planner, draw = planner_of(), np.random.default_rng(3)
    kept = 0
    for _ in range(100):
        start = draw.uniform(planner.lower, planner.upper)
        way = np.concatenate([draw.uniform(-150, 150, 3), draw.uniform(-40, 40, 3)])
        target = commanded(planner.pose(start), way, "WRF", rel=True)
        try:
            plan = planner.line(start, target, speed=1.0)
        except PlanError:
            continue
        kept += 1
        position, turn = off_the_line(planner, plan, target)
        assert position < 1.2 * STRAIGHT_M and turn < 1.2 * STRAIGHT_RAD
        assert (np.abs(plan.dq) <= planner.limits.speed * 1.01).all()
        acceleration = np.abs(np.diff(plan.dq, axis=0)) / np.diff(plan.times_s)[:, None]
        assert (acceleration <= 1.5 * planner.limits.acceleration).all()
        assert (plan.q >= planner.lower - 1e-3).all() and (plan.q <= planner.upper + 1e-3).all()
    assert kept > 20


def test_a_line_beyond_a_joints_limit_is_refused_with_its_name():
    planner = planner_of()
    target = commanded(planner.pose(planner.home_q), [0, 0, 0, 0, 90, 0], "TRF")
    with pytest.raises(PlanError, match="joint_4 at -97.0°"):
        planner.line(planner.home_q, target)


@pytest.mark.parametrize(
    "start, way, message",
    [
        (
            [1.17, 0.7, 1.17, -1.58, -1.35, -1.43],
            [-95, 102, -77, 26, -40, -35],
            "singularity that joint_6 would",
        ),
        ([-2.56, 0.95, 2.84, 0.09, 1.32, -0.16], [-48, 100, -71, -7, 26, -9], "singularity that joint_3 would"),
        ([2.99, 3.29, 2.65, -0.41, -0.02, 0.74], [-132, 17, -69, 0, 0, 0], "out of reach, or the arm in a singularity"),
    ],
)
def test_a_line_through_a_singularity_is_refused_with_the_joint_that_would_race(start, way, message):
    """The axes of joints 4 and 6 come into line; the elbow stretches; the target is beyond the stretched arm."""
    planner = planner_of()
    start = np.array(start)
    with pytest.raises(PlanError, match=message):
        planner.line(start, commanded(planner.pose(start), way, "WRF", rel=True), speed=0.1)


def test_where_the_tool_is_already_nothing_moves():
    planner = planner_of()
    plan = planner.line(planner.home_q, planner.pose(planner.home_q))
    assert np.array_equal(plan.q[0], plan.q[-1]) and plan.duration_s < 0.01


def test_from_slightly_outside_a_limit_a_line_may_lead_inwards_only():
    """At rest joints 2 and 3 lie on their lower limits, and are measured a little below."""
    planner = planner_of()
    start = planner.home_q.copy()
    start[2] = planner.lower[2] - np.radians(0.3)
    inwards = start.copy()
    inwards[2] += np.radians(4.0)
    plan = planner.line(start, planner.pose(inwards))
    assert plan.q[-1, 2] > planner.lower[2]
    outwards = start.copy()
    outwards[2] -= np.radians(3.0)
    with pytest.raises(PlanError):
        planner.line(start, planner.pose(outwards))


def test_a_duration_counts_in_place_of_the_speed():
    planner = planner_of()
    target = commanded(planner.pose(planner.home_q), [0, 0, 50, 0, 0, 0], rel=True)
    assert planner.line(planner.home_q, target, speed=0.01, duration=4.0).duration_s == pytest.approx(4.0)
    with pytest.raises(PlanError, match="takes at least"):
        planner.line(planner.home_q, target, duration=0.1)


@pytest.mark.parametrize("share", [0.02, 0.3, 0.5, 0.9, 1.0])
def test_a_stop_on_a_line_stays_on_it_and_is_soon_over(share):
    planner = planner_of()
    target = commanded(planner.pose(planner.home_q), [0, 200, 0, 0, 0, 20], rel=True)
    plan = planner.line(planner.home_q, target, speed=1.0)
    q, dq = plan.at(share * plan.duration_s)
    stop = planner.stop_on(plan, share * plan.duration_s)
    assert np.allclose(stop.q[0], q) and np.allclose(stop.dq[0], dq) and np.abs(stop.dq[-1]).max() < 1e-9
    assert stop.duration_s < 0.3
    assert (
        np.abs(np.diff(stop.dq, axis=0) / np.diff(stop.times_s)[:, None]).max() < 2.0 * planner.limits.acceleration[0]
    )
    ways = planner.pose(stop.q)[:, :3, 3] - planner.pose(planner.home_q)[:3, 3]
    assert np.abs(ways[:, [0, 2]]).max() < 5e-4


def test_rounding_never_makes_a_joint_too_fast():
    """The first motion dies away slowly, the second begins briskly the same way: together they would be too fast."""
    planner = planner_of()
    middle, end = planner.home_q + [0.9, 0, 0, 0, 0, 0], planner.home_q + [1.8, 0, 0, 0, 0, 0]
    first = planner.joints(planner.home_q, middle, speed=1.0, accel=0.3)
    second = planner.joints(middle, end, speed=1.0, accel=1.0)
    plan = planner.joined(first, second, 1.0)
    assert plan.duration_s < first.duration_s + second.duration_s
    assert (np.abs(plan.dq) <= planner.limits.speed * 1.01).all()


def test_rounding_never_takes_a_joint_beyond_its_limit():
    """Joint 6 goes to its limit and a little back; the other way round from there. Both at once would be too far."""
    planner = planner_of()
    corner, top = planner.home_q.copy(), planner.home_q.copy()
    corner[5], top[5] = planner.upper[5] - 0.2, planner.upper[5]
    times = np.array([0.0, 0.6, 1.0])
    still = np.zeros((3, 6))
    first = Plan(times, np.array([corner, top, corner]), still)
    second = Plan(1.0 - times[::-1], np.array([corner, top, corner]), still)
    plan = planner.joined(first, second, 1.0)
    assert (plan.q <= planner.upper + 1e-3).all() and plan.duration_s > 1.7


def test_a_stop_in_a_rounded_corner_is_even():
    """The first half of two joined plans ends in motion."""
    planner = planner_of()
    first = planner.joints(planner.home_q, planner.home_q + [0.5, 0, 0, 0, 0, 0], speed=1.0)
    second = planner.joints(first.q[-1], first.q[-1] + [0, 0.4, 0, 0, 0, 0], speed=1.0)
    before, _ = planner.joined(first, second, 0.1).cut(first.duration_s - 0.1)
    for left_s in (0.3, 0.1, 0.02, 0.0):
        q, dq = before.at(before.duration_s - left_s)
        stop = planner.stop_on(before, before.duration_s - left_s)
        assert np.allclose(stop.q[0], q) and np.allclose(stop.dq[0], dq) and not np.abs(stop.dq[-1]).max() > 1e-9
        drops = np.abs(np.diff(stop.dq, axis=0)) / np.diff(stop.times_s)[:, None]
        assert (drops <= 2.1 * planner.limits.acceleration).all()
