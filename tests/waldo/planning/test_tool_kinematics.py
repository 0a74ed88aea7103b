"""The tip of the tool: how it moves with the joints, and the joints that bring it to a pose."""

import numpy as np
import pytest

from lerobot_robot_yam.arm.mounting import resolve_profiles
from lerobot_robot_yam.arm.profile_files import ARMS
from lerobot_robot_yam.arm.tool_pose import rotation_vector
from lerobot_robot_yam.waldo.arm_choice import tip
from lerobot_robot_yam.waldo.planning.tool_kinematics import ToolKinematics


def kinematics_of(arm="yam"):
    profiles = resolve_profiles(arm, "linear_4310")
    kinematics = ToolKinematics(*profiles)
    kinematics.tool = tip(profiles[1], "LINEAR_4310", np.array([0.01, -0.02, 0.03]))
    return kinematics


@pytest.mark.parametrize("arm", ARMS)
def test_its_twist_is_the_derivative_of_its_pose_and_rates_are_the_inverse(arm):
    kinematics, step = kinematics_of(arm), 1e-6
    for q in np.random.default_rng(2).uniform(kinematics.lower, kinematics.upper, size=(5, 6)):
        dq = np.random.default_rng(3).normal(size=6)
        before, after = kinematics.pose(np.array([q, q + step * dq]))
        twist = kinematics.twist(q, dq)
        np.testing.assert_allclose((after[:3, 3] - before[:3, 3]) / step, twist[:3], atol=1e-5)
        np.testing.assert_allclose(rotation_vector(after[:3, :3] @ before[:3, :3].T) / step, twist[3:], atol=1e-5)
        np.testing.assert_allclose(kinematics.twist(q, kinematics.rates(q, twist)), twist, atol=1e-6)


@pytest.mark.parametrize("arm", ARMS)
def test_from_a_seed_nearby_the_joints_are_found_again(arm):
    kinematics, draw, reached = kinematics_of(arm), np.random.default_rng(3), []
    q = draw.uniform(kinematics.lower, kinematics.upper, size=(200, 6))
    q[:20, 1], q[:20, 3:5] = q[:20, 2], 0.0  # gimbal lock
    q = np.clip(q, kinematics.lower, kinematics.upper)
    for row, seed in zip(q, q + draw.uniform(-0.05, 0.05, q.shape), strict=True):
        there, found = kinematics.follow(kinematics.pose(row), row, seed)
        assert (there >= kinematics.lower).all() and (there <= kinematics.upper).all()
        reached.append(found)
        if found:
            assert np.abs(kinematics.pose(there) - kinematics.pose(row)).max() < 1e-4
    assert np.mean(reached) >= 0.985


def test_an_arm_outside_a_limit_gets_back_and_no_farther_out():
    kinematics = kinematics_of()
    q = np.array([0.3, 1.2, kinematics.lower[2] - 0.005, -1.0, 0.2, -0.3])
    for shift, reaches in ((-0.01, False), (0.0, True), (0.01, True)):
        wanted = q + [0, 0, shift, 0, 0, 0]
        there, reached = kinematics.follow(kinematics.pose(wanted), q)
        assert reached == reaches and there[2] >= q[2]


def test_from_far_away_a_way_is_found_and_it_is_always_the_same():
    kinematics, other = kinematics_of(), kinematics_of()
    middle = (kinematics.lower + kinematics.upper) / 2
    q = np.random.default_rng(4).uniform(kinematics.lower, kinematics.upper, size=(40, 6))
    found = [kinematics.solve(pose, middle) for pose in kinematics.pose(q)]
    assert np.mean([result.converged for result in found]) >= 0.95
    for result, pose in zip(found, kinematics.pose(q), strict=True):
        assert np.array_equal(result.q, other.solve(pose, middle).q)


def test_without_turning_over_it_stays_on_its_side():
    kinematics = kinematics_of()
    away = kinematics.pose(np.zeros(6))
    away[0, 3] += 3.0
    result = kinematics.solve(away, np.zeros(6), turn_over=False)
    assert not result.converged and result.attempts == 1 and np.isfinite(result.q).all()
