"""Joint moves of the planner: where they end, how fast, and what is refused."""

import numpy as np
import pytest

from lerobot_robot_yam.arm.collision.workspace import KeepOut, WorkspaceConfig
from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.profile_files import ARMS, GRIPPERS
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.arm.tool_pose import rotation_vector
from lerobot_robot_yam.errors import ConfigError, PlanError
from lerobot_robot_yam.waldo.controller.status_report import axes_enabled, joints_enabled
from lerobot_robot_yam.waldo.planning.planner import Planner
from lerobot_robot_yam.waldo.poses import commanded, to_vector
from tests.support.waldo_desk import planner_of


@pytest.fixture(scope="module")
def planner():
    return Planner(ResolvedArm(ArmConfig(channel="can0")))


def test_a_move_ends_at_rest_at_its_target_within_the_limits(planner):
    start, target = planner.home_q, planner.home_q + [0.8, -0.2, 0.1, 0.3, -0.4, 0.5]
    plan = planner.joints(start, target, speed=0.7, accel=0.5)
    q, dq = plan.at(np.linspace(0.0, plan.duration_s, 2000))
    assert np.abs(q[0] - start).max() < 1e-9 and np.abs(q[-1] - target).max() < 1e-9
    assert np.abs(dq[[0, -1]]).max() < 1e-9
    assert np.abs(dq).max() <= 0.7 * planner.limits.speed.max() + 1e-3
    step = plan.duration_s / 1999
    assert np.abs(np.gradient(q, step, axis=0)[1:-1] - dq[1:-1]).max() < 1e-2  # dq is the slope of q
    assert np.abs(np.diff(dq, axis=0)).max() / step <= 1.1 * 0.5 * planner.limits.acceleration.max()


def test_its_way_is_straight_and_the_same_at_any_speed(planner):
    start, target = planner.home_q, planner.home_q + [0.8, -0.2, 0.1, 0.3, -0.4, 0.5]
    for speed in (0.1, 1.0):
        way = planner.joints(start, target, speed=speed).q - start
        share = way[:, :1] / (target - start)[0]
        assert np.abs(way - share * (target - start)).max() < 1e-6


def test_a_duration_counts_in_place_of_the_speed(planner):
    target = planner.home_q + 0.2
    assert planner.joints(planner.home_q, target, speed=0.01, duration=3.0).duration_s == pytest.approx(3.0)
    with pytest.raises(PlanError, match="takes at least"):
        planner.joints(planner.home_q, target, duration=0.05)


def test_the_very_number_of_a_limit_is_accepted(planner):
    target = planner.home_q.copy()
    target[0] = np.radians(round(float(np.degrees(planner.upper[0])), 3))
    assert planner.joints(planner.home_q, target).q[-1, 0] <= planner.upper[0]


@pytest.mark.parametrize(
    "given, message",
    [
        ({"target_q": [0, 0, 0, 0, 0, 2.5]}, "joint_6 would be at 143"),
        ({"target_q": [0, 0, 0, 0, 0, np.nan]}, "finite"),
        ({"target_q": [0, 0, 0, 0, 0]}, "6 finite"),
        ({"target_q": "far"}, "finite"),
        ({"speed": -1.0}, "speed"),
        ({"speed": 1.5}, "speed"),
        ({"accel": np.nan}, "accel"),
        ({"duration": np.inf}, "duration"),
    ],
)
def test_what_cannot_be_meant_is_refused(planner, given, message):
    with pytest.raises(PlanError, match=message):
        planner.joints(planner.home_q, **{"target_q": planner.home_q, **given})


def test_a_stop_is_over_soon_and_does_not_turn_back(planner):
    dq = np.array([1.5, -1.5, 0.3, 0.0, 0.0, 0.1])
    plan = planner.stop(planner.home_q, dq)
    assert plan.duration_s < 0.4
    assert (plan.dq * np.sign(dq) > -1e-6).all() and np.abs(plan.dq[-1]).max() < 1e-9


def test_a_way_through_a_thing_is_refused_with_its_name():
    planner = Planner(ResolvedArm(ArmConfig(channel="can0")))
    target = planner.home_q + [1.2, 0, 0, 0, 0, 0]
    planner.joints(planner.home_q, target)
    x, y, z = planner.pose(planner.home_q + [0.6, 0, 0, 0, 0, 0])[:3, 3].tolist()
    mast = KeepOut(name="camera mast", center_m=[x, y, z], size_m=[0.05, 0.05, 0.4])
    planner.keep_clear(WorkspaceConfig(keep_out=[mast]))
    for move in (planner.joints, lambda start, goal: planner.line(start, planner.pose(goal))):
        with pytest.raises(PlanError, match="camera mast"):
            move(planner.home_q, target)
    planner.keep_clear(WorkspaceConfig())
    planner.joints(planner.home_q, target)


def test_the_configured_workspace_counts():
    config = ArmConfig(channel="can0", workspace=WorkspaceConfig(floor_z_m=0.2))
    planner = Planner(ResolvedArm(config))
    with pytest.raises(PlanError, match="floor"):
        planner.joints(planner.home_q, planner.home_q + [0, 0, -0.6, 0, 0, 0])


def test_an_arm_without_six_joints_is_refused():
    with pytest.raises(ConfigError, match="six joints"):
        Planner(ResolvedArm(ArmConfig(channel="can0", arm="none")))


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
