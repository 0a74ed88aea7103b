"""Commander's six numbers, there and back, in gimbal lock too."""

import mink
import numpy as np
import pytest

from lerobot_robot_yam.errors import PlanError
from lerobot_robot_yam.waldo.poses import commanded, from_command, from_vector, to_command, to_vector

LOCKED = [s * (np.pi / 2 - off) for s in (1.0, -1.0) for off in (0.0, 1e-12, 1e-8, 3e-7, 1e-5)]


def turned(axis, angle):
    return mink.SO3.exp(angle * np.eye(3)[axis]).as_matrix()


@pytest.mark.parametrize("ry", [0.3, -1.2, *LOCKED])
@pytest.mark.parametrize("rx, rz", [(0.4, -0.7), (3.1, 3.1), (-2.0, 0.0)])
def test_angles_are_intrinsic_xyz_and_come_back(rx, ry, rz):
    pose = from_vector([0.1, 0.2, 0.3, rx, ry, rz])
    assert np.allclose(pose[:3, :3], turned(0, rx) @ turned(1, ry) @ turned(2, rz), atol=1e-12)
    assert np.abs(from_vector(to_vector(pose)) - pose).max() < 1e-7
    assert np.array_equal(to_vector(np.array([[pose, np.eye(4)]]))[0, 0], to_vector(pose))  # many poses are one call


def test_commands_are_in_mm_and_degrees():
    pose = from_command([100.0, 0.0, -50.0, 0.0, 0.0, 90.0])
    assert np.allclose(pose[:3, 3], [0.1, 0.0, -0.05]) and np.allclose(pose[:3, :3], turned(2, np.pi / 2))
    assert np.allclose(to_command(pose), [100.0, 0.0, -50.0, 0.0, 0.0, 90.0])


def test_a_relative_command_shifts_and_turns_along_the_axes_of_its_frame():
    now = from_command([300.0, 0.0, 200.0, 0.0, 90.0, 0.0])  # the tool's z is the base's x
    along = commanded(now, [0, 0, 10.0, 0, 0, 0], "TRF", rel=True)
    assert np.allclose(to_command(along)[:3], [310.0, 0.0, 200.0]) and np.allclose(along[:3, :3], now[:3, :3])
    up = commanded(now, [0, 0, 10.0, 0, 0, 5.0], "WRF", rel=True)
    assert np.allclose(to_command(up)[:3], [300.0, 0.0, 210.0])
    assert np.allclose(up[:3, :3], turned(2, np.radians(5.0)) @ now[:3, :3])
    rolled = commanded(now, [0, 0, 0, 0, 0, 5.0], "TRF", rel=True)
    assert np.allclose(rolled[:3, :3], now[:3, :3] @ turned(2, np.radians(5.0)))


@pytest.mark.parametrize("pose", [[0, 0, 0, 0, 0], [np.nan] * 6, "there", None, [[0] * 6], [np.inf, 0, 0, 0, 0, 0]])
def test_what_is_no_pose_is_refused(pose):
    with pytest.raises(PlanError, match="6 finite numbers"):
        commanded(np.eye(4), pose)


def test_a_frame_that_is_none_is_refused():
    with pytest.raises(PlanError, match="NOPE"):
        commanded(np.eye(4), [0] * 6, "NOPE")
