"""Poses of a tool as six numbers: they come back, half a turn too, and nonsense is refused."""

import numpy as np
import pytest

from lerobot_robot_yam.arm.kinematics import YamKinematics
from lerobot_robot_yam.arm.profile_files import ARMS, GRIPPERS
from lerobot_robot_yam.arm.tool_pose import downward, pose_to_vector, rotation_matrix, rotation_vector, vector_to_pose
from lerobot_robot_yam.errors import ActionError


@pytest.mark.parametrize("gripper", GRIPPERS)
@pytest.mark.parametrize("arm", ARMS)
def test_the_reference_points_down_and_forward(arm, gripper):
    kinematics = YamKinematics(arm, gripper)
    reference = downward(kinematics)
    assert reference[:, 2] == pytest.approx([0, 0, -1], abs=1e-3)  # tcp_site's z is where the tool points
    heading = 0.4
    q = np.array([heading, 1.2, 1.0, 0.0, 0.0, 0.0])
    q[3] = q[1] - q[2] - np.pi / 2  # joints 2, 3 and 4 turn about one axis: the tool straight down
    vector = pose_to_vector(kinematics.fk(q), reference)
    assert vector[3:] == pytest.approx([0, 0, heading], abs=1e-3)


def test_six_numbers_and_poses_are_the_same_thing():
    kinematics, rng = YamKinematics("big_yam", "linear_4310"), np.random.default_rng(0)
    reference = downward(kinematics)
    for q in rng.uniform(kinematics.lower, kinematics.upper, size=(50, 6)):
        pose = kinematics.fk(q)
        vector = pose_to_vector(pose, reference)
        np.testing.assert_allclose(vector_to_pose(vector, reference), pose, atol=1e-9)
        assert np.linalg.norm(vector[3:]) <= np.pi + 1e-9


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-4, 1.0, np.pi - 1e-9, np.pi])
def test_rotation_vectors_come_back(angle):
    for axis in (*np.eye(3), *np.random.default_rng(0).normal(size=(5, 3))):
        rotation = rotation_matrix(angle * axis / np.linalg.norm(axis))
        assert np.abs(rotation_matrix(rotation_vector(rotation)) - rotation).max() < 1e-7


def test_exactly_half_a_turn_is_a_turn():
    assert np.linalg.norm(rotation_vector(np.diag([1.0, -1.0, -1.0]))) == pytest.approx(np.pi)


def test_numbers_that_are_no_rotation_are_refused():
    with pytest.raises(ActionError, match="no pose"):
        vector_to_pose(np.array([0, 0, 0, 1e200, 0, 0]), downward(YamKinematics("yam", "linear_4310")))
