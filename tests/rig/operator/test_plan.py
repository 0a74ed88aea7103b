"""Joint paths of the scripted operator: they go where they should, within limits."""

import numpy as np
import pytest

from lerobot_robot_yam.arm.model import build_model
from lerobot_robot_yam.arm.profile_files import load_arm
from lerobot_robot_yam.errors import RigError
from lerobot_robot_yam.rig.operator.plan import ArmPlanner

BASES = {"straight": ([0.0, 0.25, 0.0], 0.0), "turned": ([0.1, -0.2, 0.0], 0.7)}
SPEED, ACCELERATION = 1.2, 7.0


@pytest.fixture(params=BASES)
def planner(request):
    position, yaw = BASES[request.param]
    model = build_model("yam", "linear_4310", visuals=False)
    return ArmPlanner(model, np.array(position), yaw, seed_rad=load_arm("yam").bent_q_rad, leads=slice(2, -1))


def in_front(planner: ArmPlanner, forward_m: float, left_m: float, up_m: float) -> np.ndarray:
    """A point in the world, given in the arm's own frame."""
    c, s = np.cos(planner._yaw), np.sin(planner._yaw)
    return planner.base_m + np.array([c * forward_m - s * left_m, s * forward_m + c * left_m, up_m])


def test_a_transfer_stays_within_speed_and_acceleration_and_ends_there(planner):
    start = planner.pose(in_front(planner, 0.3, 0.1, 0.02), planner.natural_yaw(in_front(planner, 0.3, 0.1, 0.02)))
    target = in_front(planner, 0.33, -0.22, 0.02)
    yaw = planner.natural_yaw(target)
    path = planner.transfer(start, target, yaw, 0.12)
    speed = np.diff(path.q_rad, axis=0) / np.diff(path.times_s)[:, None]
    assert np.abs(speed).max() <= SPEED * 1.001
    assert np.abs(np.diff(speed, axis=0) / np.diff(path.times_s)[1:, None]).max() <= ACCELERATION * 1.001
    assert np.abs(speed[[0, -1]]).max() < 0.1  # begins and ends at rest
    assert path.q_rad[0] == pytest.approx(start, abs=5e-3)
    position, found = planner.tool(path.end_rad)
    assert position == pytest.approx(target, abs=2e-3) and found == pytest.approx(yaw, abs=0.01)
    heights = [planner.tool(q)[0][2] for q in path.q_rad]
    assert max(heights) > 0.11 and min(heights) > 0.015


def test_a_straight_path_is_straight_and_within_limits(planner):
    first, last = in_front(planner, 0.3, 0.1, 0.12), in_front(planner, 0.35, -0.02, 0.05)
    yaw = planner.natural_yaw(first)
    path = planner.straight(planner.pose(first, yaw), last, yaw + 0.5, least_s=0.7)
    along = (last - first) / np.linalg.norm(last - first)
    for q in path.q_rad:
        off = planner.tool(q)[0] - first
        assert np.linalg.norm(off - (off @ along) * along) < 5e-4
    position, found = planner.tool(path.end_rad)
    assert position == pytest.approx(last, abs=2e-4) and found == pytest.approx(yaw + 0.5, abs=2e-3)
    assert path.duration_s >= 0.7
    assert (np.abs(np.diff(path.q_rad, axis=0)) / np.diff(path.times_s)[:, None]).max() <= SPEED * 1.001
    with pytest.raises(RigError, match="cannot reach"):
        planner.straight(path.end_rad, in_front(planner, 0.9, 0.0, 0.1), yaw)


def test_a_point_out_of_reach_is_refused(planner):
    far = in_front(planner, 0.9, 0.0, 0.02)
    assert not planner.reaches(far, planner.natural_yaw(far))
    with pytest.raises(RigError, match="cannot reach"):
        planner.pose(far, 0.0)
    near = planner.pose(in_front(planner, 0.3, 0.0, 0.1), planner.natural_yaw(in_front(planner, 0.3, 0.0, 0.1)))
    with pytest.raises(RigError, match="cannot reach"):
        planner.transfer(near, far, 0.0, 0.12)


def test_unfolding_from_rest_keeps_the_tool_off_the_table(planner):
    rest = np.array([0.0, 0.0, 0.0, -0.1666, 0.0, 0.0])
    end = planner.pose(in_front(planner, 0.26, -0.06, 0.13), planner.natural_yaw(in_front(planner, 0.26, -0.06, 0.13)))
    path = planner.unfold(rest, end)
    assert path.q_rad[0] == pytest.approx(rest) and path.end_rad == pytest.approx(end)
    assert min(planner.tool(q)[0][2] for q in path.q_rad) > 0.04
