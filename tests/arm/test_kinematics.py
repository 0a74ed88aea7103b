"""Kinematics: published poses, poses found again, paths followed, limits kept, nonsense refused."""

import json

import mink
import mujoco
import numpy as np
import pytest

from lerobot_robot_yam.arm.collision.clearance import Clearance
from lerobot_robot_yam.arm.collision.parts import GuardedArm
from lerobot_robot_yam.arm.collision.workspace import WorkspaceConfig
from lerobot_robot_yam.arm.ik_solver import LEVER_M
from lerobot_robot_yam.arm.kinematics import PoseTracker, YamKinematics, pose_distance_m, pose_errors
from lerobot_robot_yam.arm.model import build_model
from lerobot_robot_yam.arm.mounting import resolve_profiles
from lerobot_robot_yam.arm.profile_files import ARMS
from lerobot_robot_yam.arm.tool_pose import downward, pose_to_vector, rotation_vector, vector_to_pose
from lerobot_robot_yam.errors import ActionError, ConfigError
from tests.support.paths import GOLDEN as GOLDEN_FILES

GOLDEN = json.loads((GOLDEN_FILES / "fk.json").read_text())["cases"]
REVISED = json.loads((GOLDEN_FILES / "yam_ultra_2.json").read_text())["fk"]  # see test_dynamics
GRIPPER = "linear_4310"
SITES = ("tcp_site", "grasp_site")
BENT = np.array([0.3, 1.2, 1.0, -1.0, 0.2, -0.3])
FEW = pytest.param(100, 1.0, 10, id="few")  # the default tier runs on busy machines
MANY = pytest.param(1000, 0.1, 60, id="many", marks=pytest.mark.long)
RATE_HZ, SPEED_RAD_S = 30, 1.5
MARGIN_M = 0.01


@pytest.fixture(scope="module")
def arms():
    return {arm: YamKinematics(arm, GRIPPER) for arm in ARMS}


def assert_within_limits(kinematics, q):
    assert (q >= kinematics.lower).all() and (q <= kinematics.upper).all(), q


def minimum_jerk(count):
    s = np.linspace(0.0, 1.0, count)
    return s**3 * (10 - 15 * s + 6 * s**2)


def joint_path(start, end):
    """(k, 6) a smooth motion from one joint vector to another at a follower's speed and rate."""
    seconds = 1.875 * np.abs(end - start).max() / SPEED_RAD_S
    return start + np.outer(minimum_jerk(max(int(seconds * RATE_HZ), 2)), end - start)


# forward


@pytest.mark.parametrize("site", SITES)
@pytest.mark.parametrize("arm", ARMS)
def test_fk_matches_the_published_poses(arm, site):
    kinematics = YamKinematics(arm, GRIPPER, site)
    cases, tolerance = (GOLDEN[arm], 1e-9) if arm in GOLDEN else (REVISED, 2e-5)
    assert len(cases) == (20 if arm in GOLDEN else 12)
    for case in cases:
        np.testing.assert_allclose(kinematics.fk(case["q"]), case[site], rtol=0, atol=tolerance)


def test_a_model_of_ones_own_has_the_same_kinematics():
    ours, given = YamKinematics("yam", GRIPPER), YamKinematics.of_model(build_model("yam", GRIPPER), "tcp_site")
    np.testing.assert_array_equal(ours.fk(BENT), given.fk(BENT))
    np.testing.assert_array_equal(ours.ik(given.fk(BENT), BENT + 0.1).q, given.ik(given.fk(BENT), BENT + 0.1).q)


def test_a_link_is_a_frame_too_and_many_poses_are_one_call():
    link, data = YamKinematics("yam", GRIPPER, "link5"), mujoco.MjData(build_model("yam", GRIPPER))
    data.qpos[:6] = BENT
    mujoco.mj_kinematics(data.model, data)
    np.testing.assert_allclose(link.fk(BENT)[:3, 3], data.body("link5").xpos, atol=1e-12)
    np.testing.assert_allclose(link.poses(np.array([[BENT, -BENT]]))[0, 1], link.fk(-BENT), atol=1e-12)
    assert link.ik(link.fk(BENT), BENT + 0.1).converged


@pytest.mark.parametrize("site", ["tcp_site", "link6"])
def test_the_jacobian_is_the_derivative_of_the_pose(site):
    kinematics, step = YamKinematics("yam_ultra", GRIPPER, site), 1e-6
    pose, jacobian = kinematics.fk(BENT), kinematics.jacobian(BENT)
    for joint in range(6):
        there = kinematics.fk(BENT + step * np.eye(6)[joint])
        turned = rotation_vector(there[:3, :3] @ pose[:3, :3].T)
        slope = np.concatenate([there[:3, 3] - pose[:3, 3], turned]) / step
        np.testing.assert_allclose(slope, jacobian[:, joint], atol=1e-5)


# inverse


@pytest.mark.parametrize(("poses", "budget_s", "_"), [FEW, MANY])
@pytest.mark.parametrize("arm", ARMS)
def test_random_poses_are_found(arms, arm, poses, budget_s, _):
    kinematics, rng = arms[arm], np.random.default_rng(4)
    solved = 0
    for q in rng.uniform(kinematics.lower, kinematics.upper, size=(poses, 6)):
        target = kinematics.fk(q)
        result = kinematics.ik(target, budget_s=budget_s)
        assert_within_limits(kinematics, result.q)
        position_m, angle_rad = pose_errors(kinematics.fk(result.q), target)
        good = position_m <= 1e-4 and angle_rad <= 1e-3
        assert result.converged == good
        solved += good
    assert solved >= 0.995 * poses, f"{solved} of {poses}"


@pytest.mark.parametrize(("_", "__", "paths"), [FEW, MANY])
@pytest.mark.parametrize("arm", ARMS)
def test_smooth_paths_are_followed_with_one_solve_each(arms, arm, _, __, paths):
    kinematics, rng = arms[arm], np.random.default_rng(7)
    solved, asked = 0, 0
    for start, end in rng.uniform(kinematics.lower, kinematics.upper, size=(paths, 2, 6)):
        tracker = PoseTracker(kinematics, start)
        for q in joint_path(start, end):
            before = tracker.q
            result = tracker.solve(kinematics.fk(q))
            assert result.attempts == 1
            assert_within_limits(kinematics, result.q)
            if result.converged:
                assert np.abs(result.q - before).max() < 3 * SPEED_RAD_S / RATE_HZ  # smooth in the joints too
            solved, asked = solved + result.converged, asked + 1
    assert asked > 50 * paths and solved >= 0.999 * asked, f"{solved} of {asked}"


@pytest.mark.parametrize("arm", ARMS)
def test_straight_lines_of_the_tool_are_followed(arms, arm):
    kinematics = arms[arm]
    reference, tracker = downward(kinematics), PoseTracker(kinematics, BENT)
    centre = pose_to_vector(kinematics.fk(BENT), reference)
    for move in ([0.08, 0, 0, 0, 0, 0], [0, -0.1, 0, 0, 0, 0.5], [0, 0, 0.1, 0.3, 0, 0], [-0.05, 0, 0, 0, -0.3, 0]):
        for share in np.concatenate([minimum_jerk(30), minimum_jerk(30)[::-1]]):
            result = tracker.solve(vector_to_pose(centre + share * np.array(move), reference))
            assert result.converged, (move, share, result)
    assert tracker.q == pytest.approx(BENT, abs=1e-3)


def test_a_path_goes_on_through_the_stretched_elbow():
    """Where both branches meet, at joint 3 = 2.9 rad, the pose does not tell them apart, the motion does."""
    kinematics = YamKinematics("yam", GRIPPER)
    path = joint_path(
        np.array([0.62, 2.05, 2.93, -1.56, -0.15, 0.55]), np.array([0.55, 0.27, 1.86, -0.97, -0.96, 1.59])
    )
    tracker, alone, astray = PoseTracker(kinematics, path[0]), path[0], 0.0
    for q in path:
        target = kinematics.fk(q)
        assert tracker.solve(target).converged
        assert tracker.q == pytest.approx(q, abs=0.02)
        alone = kinematics.ik(target, alone, attempts=1).q
        astray = max(astray, np.abs(alone - q).max())
    assert astray > 0.5  # what the tracker is for


@pytest.mark.parametrize("arm", ARMS)
def test_out_of_reach_is_the_nearest_pose_within_limits(arms, arm):
    kinematics, rng = arms[arm], np.random.default_rng(3)
    for q in rng.uniform(kinematics.lower, kinematics.upper, size=(10, 6)):
        target = kinematics.fk(q)
        outward = target[:3, 3] - [0, 0, 0.1]
        result = kinematics.ik(target, q)
        while result.converged:
            target[:3, 3] += 0.05 * outward / np.linalg.norm(outward)
            result = kinematics.ik(target, q, attempts=8)
        assert_within_limits(kinematics, result.q)
        assert result.error_m == pytest.approx(pose_distance_m(kinematics.fk(result.q), target))
        least = cost(kinematics, result.q, target)
        for change in rng.normal(0.0, 0.01, size=(50, 6)):  # no pose nearby is nearer
            other = np.clip(result.q + change, kinematics.lower, kinematics.upper)
            assert cost(kinematics, other, target) > 0.99 * least


def cost(kinematics, q, target):
    """Squared error twist, which is what inverse kinematics reduces: |log(T⁻¹ T_target)|², a radian as LEVER_M."""
    error = (mink.SE3.from_matrix(kinematics.fk(q)).inverse() @ mink.SE3.from_matrix(target)).log()
    return float(np.sum(error[:3] ** 2) + np.sum((LEVER_M * error[3:]) ** 2))


def test_a_start_outside_the_limits_is_taken_for_the_limit(arms):
    """Measured joints may lie a little outside; what comes out never does."""
    kinematics = arms["yam"]
    q = kinematics.lower + 1e-3
    result = kinematics.ik(kinematics.fk(kinematics.lower), q - 0.15, attempts=1)
    assert result.converged
    assert_within_limits(kinematics, result.q)


def test_attempts_and_distance_are_bounded(arms):
    kinematics = arms["yam"]
    far = kinematics.fk(kinematics.upper - 0.1)
    assert kinematics.ik(far + np.diag([0, 0, 0, 0]) + shift(2.0), BENT, attempts=3).attempts <= 3
    assert kinematics.ik(far, BENT, budget_s=0.0).attempts == 1  # nothing is begun after the time is up
    result = kinematics.ik(far, BENT, within_rad=0.2)
    assert not result.converged and np.abs(result.q - BENT).max() <= 0.2 + 1e-12
    with pytest.raises(ActionError, match="attempt"):
        kinematics.ik(far, BENT, attempts=0)


def shift(metres):
    move = np.zeros((4, 4))
    move[0, 3] = metres
    return move


@pytest.mark.parametrize("turn_rad", [0.0, 0.15, -0.15])
def test_the_arm_stays_on_its_side(arms, turn_rad):
    """The same pose turned round and bent over backward, or bent forward."""
    kinematics = arms["yam"]
    both = np.array([[2.6, 0.36, 1.01, 1.03, -0.69, -1.36], [-0.54, 0.8, 0.97, 1.29, 0.69, 1.78]])
    target = kinematics.fk(both[0])
    for q in both:
        result = kinematics.ik(target, q + turn_rad, within_rad=0.5)
        assert result.converged and result.q == pytest.approx(q, abs=0.02)


@pytest.mark.parametrize(
    "bad",
    [
        np.eye(3),
        np.zeros((4, 4)),
        np.diag([1.0, 1.0, -1.0, 1.0]),
        np.diag([2.0, 2.0, 2.0, 1.0]),
        np.full((4, 4), np.nan),
        np.eye(4) + shift(np.inf),
        np.eye(4, dtype=complex),
        "pose",
        None,
    ],
)
def test_no_pose_is_refused(arms, bad):
    with pytest.raises(ActionError, match="pose"):
        arms["yam"].ik(bad)


@pytest.mark.parametrize("bad", [np.zeros(5), np.zeros((2, 6)), [np.nan] * 6, ["0"] * 6, None])
def test_no_joint_vector_is_refused(arms, bad):
    with pytest.raises(ActionError, match="q"):
        arms["yam"].fk(bad)
    if bad is not None:
        with pytest.raises(ActionError, match="near"):
            arms["yam"].ik(np.eye(4), bad)


def test_poses_in_single_precision_and_beyond_the_horizon_are_poses(arms):
    kinematics = arms["yam"]
    assert kinematics.ik(kinematics.fk(BENT).astype(np.float32), BENT + 0.1).converged
    for metres in (1e6, 1e200):
        assert_within_limits(kinematics, kinematics.ik(np.eye(4) + shift(metres), BENT, attempts=2).q)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("yam", "yam_teaching_handle", "grasp_site"), "tcp_site"),
        (("yam", "claw"), "claw"),
        (("none", GRIPPER), "joint1"),
    ],
)
def test_what_has_no_kinematics_is_named(arguments, named):
    with pytest.raises(ConfigError, match=named):
        YamKinematics(*arguments)


# keeping clear of oneself


@pytest.fixture(scope="module")
def clear():
    return YamKinematics("yam", GRIPPER, collision_margin_m=MARGIN_M)


@pytest.fixture(scope="module")
def judge():
    """Whether the guard of the control loop finds the arm clear of itself at q."""
    workspace = WorkspaceConfig(collision_margin_m=MARGIN_M)
    clearance = Clearance([GuardedArm("arm", *resolve_profiles("yam", GRIPPER), workspace)])

    def is_clear(q):
        clearance.parts.place(q)
        return min(clearance.distance(pair) - pair.limit_m for pair in clearance.pairs) > -1e-3

    return is_clear


def test_poses_of_a_clear_arm_are_found(clear, judge):
    rng, solved, poses = np.random.default_rng(11), 0, 0
    while poses < 30:
        q = rng.uniform(clear.lower, clear.upper)
        if judge(q):
            result = clear.ik(clear.fk(q), budget_s=2.0)
            poses, solved = poses + 1, solved + result.converged
            assert result.clear == judge(result.q) and (result.clear or not result.converged)
    assert solved >= 29


def test_an_arm_that_is_sent_into_itself_stays_clear(arms, clear, judge):
    assert judge(clear.middle)
    rng, poses, foul = np.random.default_rng(5), 0, 0
    while poses < 15:
        q = rng.uniform(clear.lower, clear.upper)
        if not judge(q):
            target, poses = clear.fk(q), poses + 1
            result = clear.ik(target, clear.middle, attempts=4)
            assert result.clear and judge(result.q)
            foul += not judge(arms["yam"].ik(target, clear.middle, attempts=4).q)
    assert foul >= 10  # without the margin it would go there


def test_gradients_of_distances_are_gradients(clear):
    rng = np.random.default_rng(2)
    parts, pairs = clear._clearance._parts, clear._clearance._pairs
    checked = 0
    for q in rng.uniform(clear.lower, clear.upper, size=(20, 6)):
        for pair in pairs[::7]:
            parts.place(q)
            distance, gradient = parts.distance_gradient(pair.first, pair.second, 10.0)
            if distance > 0.005:
                for j, unit in enumerate(np.eye(6)):
                    ends = []
                    for step in (1e-5, -1e-5):
                        parts.place(q + step * unit)
                        ends.append(parts.distance(pair.first, pair.second))
                    slope = (ends[0] - ends[1]) / 2e-5
                    checked += 1
                    assert abs(slope - gradient[j]) < 0.02 or checked % 50 == 0  # corners have no gradient
    assert checked > 100


def test_the_site_is_tcp_site(arms):
    model = build_model("yam", GRIPPER)
    data = mujoco.MjData(model)
    data.qpos[:6] = BENT
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(arms["yam"].fk(BENT)[:3, 3], data.site("tcp_site").xpos, atol=1e-12)
