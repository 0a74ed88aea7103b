"""Kinematics with numpy alone: the published poses, those of `arm.kinematics`, and back to the joints."""

import json
import subprocess
import sys

import numpy as np
import pytest

from lerobot_robot_yam.arm.kinematics import YamKinematics
from lerobot_robot_yam.arm.mounting import resolve_profiles
from lerobot_robot_yam.arm.profile_files import ARMS, GRIPPERS, load_arm
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.waldo.kinematics.inverse import TOLERANCE_M, TOLERANCE_RAD, descend, solve
from lerobot_robot_yam.waldo.kinematics.rotation import cross_matrix, to_turn
from lerobot_robot_yam.waldo.kinematics.serial_chain import SerialChain, tool_centre
from tests.support.paths import GOLDEN as GOLDEN_FILES

GOLDEN = json.loads((GOLDEN_FILES / "fk.json").read_text())["cases"]
SEED_RAD = 0.05
POSES = 1000


def apart(first, second):
    """How far poses (k, 4, 4) are apart: the largest distance, m, and angle, rad."""
    turn = to_turn(first[:, :3, :3] @ np.swapaxes(second[:, :3, :3], -1, -2))
    return np.linalg.norm(first[:, :3, 3] - second[:, :3, 3], axis=1).max(), np.linalg.norm(turn, axis=1).max()


@pytest.mark.parametrize("arm", GOLDEN)
def test_it_matches_the_published_poses(arm):
    profile, gripper = resolve_profiles(arm, "linear_4310")
    q = np.array([case["q"] for case in GOLDEN[arm]])
    published = np.array([case["grasp_site"] for case in GOLDEN[arm]])
    assert max(apart(SerialChain(profile).pose(q) @ tool_centre(gripper), published)) < 1e-9


@pytest.mark.parametrize("arm", ARMS)
@pytest.mark.parametrize("gripper", GRIPPERS)
def test_it_is_the_kinematics_of_the_arm(arm, gripper):
    profile, mounted = resolve_profiles(arm, gripper)
    site = "tcp_site" if gripper == "yam_teaching_handle" else "grasp_site"
    chain, other = SerialChain(profile), YamKinematics(profile, mounted, site)
    q = np.random.default_rng(1).uniform(chain.lower, chain.upper, size=(20, chain.n))
    assert max(apart(chain.pose(q) @ tool_centre(mounted), np.array([other.fk(row) for row in q]))) < 1e-9


def test_its_jacobian_is_the_derivative_of_its_pose():
    chain, step = SerialChain(load_arm("yam_ultra")), 1e-6
    for q in np.random.default_rng(2).uniform(chain.lower, chain.upper, size=(5, chain.n)):
        pose, jacobian = chain.place(q)
        assert np.abs(pose - chain.pose(q)).max() < 1e-12
        for joint in range(chain.n):
            there = chain.pose(q + step * np.eye(chain.n)[joint])
            slope = (there[:3, 3] - pose[:3, 3]) / step
            turning = cross_matrix(jacobian[3:, joint]) @ pose[:3, :3]
            assert np.abs(slope - jacobian[:3, joint]).max() < 1e-5
            assert np.abs((there[:3, :3] - pose[:3, :3]) / step - turning).max() < 1e-5


@pytest.mark.parametrize("arm", ARMS)
def test_from_a_seed_nearby_it_finds_the_joints_again(arm):
    chain, draw = SerialChain(load_arm(arm)), np.random.default_rng(3)
    q = draw.uniform(chain.lower, chain.upper, size=(POSES, chain.n))
    q[: POSES // 10, 1], q[: POSES // 10, 3:5] = q[: POSES // 10, 2], 0.0  # gimbal lock
    q = np.clip(q, chain.lower, chain.upper)
    poses = chain.pose(q)
    found = [
        solve(chain, pose, row) for pose, row in zip(poses, q + draw.uniform(-SEED_RAD, SEED_RAD, q.shape), strict=True)
    ]
    solutions = np.array([solution.q[0] for solution in found])
    assert (solutions >= chain.lower).all() and (solutions <= chain.upper).all()
    reached = np.array([solution.reached[0] for solution in found])
    assert reached.mean() >= 0.995
    assert (np.array(apart(chain.pose(solutions[reached]), poses[reached])) < 1e-4).all()


def test_it_finds_poses_with_joints_at_their_limits():
    chain, draw = SerialChain(load_arm("yam")), np.random.default_rng(11)
    q = draw.uniform(chain.lower, chain.upper, size=(600, chain.n))
    at_end = draw.random(q.shape) < 0.3
    q = np.where(at_end, np.where(draw.random(q.shape) < 0.5, chain.lower, chain.upper), q)
    seeds = q + draw.uniform(-0.15, 0.15, q.shape)
    assert descend(chain, chain.pose(q), seeds).reached.mean() >= 0.985


def test_from_far_away_it_finds_a_way_as_well():
    chain, draw = SerialChain(load_arm("yam")), np.random.default_rng(4)
    q = draw.uniform(chain.lower, chain.upper, size=(40, chain.n))
    seed = (chain.lower + chain.upper) / 2
    found = [solve(chain, pose, seed) for pose in chain.pose(q)]
    assert np.mean([solution.reached[0] for solution in found]) >= 0.95


def test_together_or_alone_the_solutions_are_the_same():
    chain, draw = SerialChain(load_arm("yam")), np.random.default_rng(5)
    q = draw.uniform(chain.lower, chain.upper, size=(24, chain.n))
    seeds, poses = q + draw.uniform(-0.1, 0.1, q.shape), chain.pose(q)
    together = descend(chain, poses, seeds)
    alone = np.array([descend(chain, pose[None], seed[None]).q[0] for pose, seed in zip(poses, seeds, strict=True)])
    assert np.abs(together.q - alone).max() < 1e-6
    assert (together.position_m[together.reached] <= TOLERANCE_M).all()
    assert (together.turn_rad[together.reached] <= TOLERANCE_RAD).all()


def test_out_of_reach_and_nonsense_are_no_solutions():
    chain, seed = SerialChain(load_arm("yam")), np.zeros(6)
    away = chain.pose(seed)
    away[0, 3] += 3.0
    for target in (away, np.full((4, 4), np.nan), np.full((4, 4), np.inf)):
        solution = solve(chain, target, seed)
        assert not solution.reached[0] and np.isfinite(solution.q).all()


def test_without_joints_there_is_nothing_to_plan():
    with pytest.raises(ConfigError, match="no joints"):
        SerialChain(load_arm("none"))


def test_it_loads_nothing_heavy():
    """Each of Commander's pool workers imports it."""
    code = (
        "import sys, lerobot_robot_yam.waldo.kinematics.inverse, lerobot_robot_yam.waldo.model.arm_model; "
        "print([name for name in ('mujoco', 'mink', 'scipy', 'torch', 'lerobot') if name in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"
