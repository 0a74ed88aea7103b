"""Commander's angles, there and back, in gimbal lock too."""

import numpy as np
import pytest

from lerobot_robot_yam.errors import PlanError
from lerobot_robot_yam.waldo.kinematics.frames import commanded, of_command, to_command
from lerobot_robot_yam.waldo.kinematics.rotation import (
    of_angles,
    of_turn,
    of_vector,
    to_angles,
    to_rpy,
    to_turn,
    to_vector,
)

LOCKED = [s * (np.pi / 2 - off) for s in (1.0, -1.0) for off in (0.0, 1e-12, 1e-8, 3e-7, 1e-5)]


def turned(axis, angle):
    return of_turn(angle * np.eye(3)[axis])


@pytest.mark.parametrize("ry", [0.3, -1.2, *LOCKED])
@pytest.mark.parametrize("rx, rz", [(0.4, -0.7), (3.1, 3.1), (-2.0, 0.0)])
def test_angles_are_intrinsic_xyz_and_come_back(rx, ry, rz):
    rotation = turned(0, rx) @ turned(1, ry) @ turned(2, rz)
    assert np.allclose(of_angles(np.array([rx, ry, rz])), rotation, atol=1e-12)
    assert np.abs(of_angles(to_angles(rotation)) - rotation).max() < 1e-7


@pytest.mark.parametrize("yaw, pitch, roll", [(0.4, -0.3, 1.2), (-2.0, 1.5, 3.0), (0.5, np.pi / 2, 0.2)])
def test_rpy_is_that_of_urdf(yaw, pitch, roll):
    rotation = turned(2, yaw) @ turned(1, pitch) @ turned(0, roll)
    x, y, z = to_rpy(rotation)
    assert np.allclose(turned(2, z) @ turned(1, y) @ turned(0, x), rotation, atol=1e-7)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-4, 1.0, np.pi - 1e-9, np.pi])
def test_rotation_vectors_come_back(angle):
    for axis in np.random.default_rng(0).normal(size=(5, 3)):
        rotation = of_turn(angle * axis / np.linalg.norm(axis))
        assert np.abs(of_turn(to_turn(rotation)) - rotation).max() < 1e-7


def test_many_poses_are_one_call():
    vectors = np.random.default_rng(1).uniform(-1.0, 1.0, size=(7, 6))
    assert np.allclose(to_vector(of_vector(vectors)), vectors)
    assert np.allclose(of_vector(vectors)[3], of_vector(vectors[3]))


def test_commands_are_in_mm_and_degrees():
    pose = of_command([100.0, 0.0, -50.0, 0.0, 0.0, 90.0])
    assert np.allclose(pose[:3, 3], [0.1, 0.0, -0.05]) and np.allclose(pose[:3, :3], turned(2, np.pi / 2))
    assert np.allclose(to_command(pose), [100.0, 0.0, -50.0, 0.0, 0.0, 90.0])


def test_a_relative_command_shifts_and_turns_along_the_axes_of_its_frame():
    now = of_command([300.0, 0.0, 200.0, 0.0, 90.0, 0.0])  # the tool's z is the base's x
    along = commanded(now, [0, 0, 10.0, 0, 0, 0], "TRF", rel=True)
    assert np.allclose(to_command(along)[:3], [310.0, 0.0, 200.0]) and np.allclose(along[:3, :3], now[:3, :3])
    up = commanded(now, [0, 0, 10.0, 0, 0, 5.0], "WRF", rel=True)
    assert np.allclose(to_command(up)[:3], [300.0, 0.0, 210.0])
    assert np.allclose(up[:3, :3], turned(2, np.radians(5.0)) @ now[:3, :3])
    rolled = commanded(now, [0, 0, 0, 0, 0, 5.0], "TRF", rel=True)
    assert np.allclose(rolled[:3, :3], now[:3, :3] @ turned(2, np.radians(5.0)))


@pytest.mark.parametrize("pose", [[0, 0, 0, 0, 0], [np.nan] * 6, "there", None, [[0] * 6], [np.inf, 0, 0, 0, 0, 0]])
def test_what_is_no_pose_is_refused(pose):
    with pytest.raises(PlanError, match="six"):
        commanded(np.eye(4), pose)


def test_a_frame_that_is_none_is_refused():
    with pytest.raises(PlanError, match="NOPE"):
        commanded(np.eye(4), [0] * 6, "NOPE")
