"""Velocities corrected by recorded poses bring a base along the recorded way, wherever it begins."""

import numpy as np
import pytest

from lerobot_robot_yam.face.devices.replayed_path import ReplayedPath
from lerobot_robot_yam.mobile.odometry import Odometry
from lerobot_robot_yam.state.base_records import BASE_STATE_DTYPE, BaseState

DT = 1 / 30


def at(pose, height_m=None):
    """State of a base at a pose; with a rail at a height."""
    record = np.zeros((), BASE_STATE_DTYPE)
    record["pose"], record["motors"] = pose, 8
    if height_m is not None:
        record["motors"], record["rail_homed"] = 9, True
        record["rail_m_per_rad"], record["rail_zero_rad"], record["q"][8] = 1.0, 0.0, height_m
    return BaseState(record)


def recorded(frames=240):
    """Twists of a curve with a turn on the spot, and the poses before each of them."""
    odometry, twists, poses = Odometry(), [], []
    odometry.pose = np.array([1.0, -2.0, 0.7])
    for frame in range(frames):
        twist = np.array([0.3, 0.05, 0.3]) if frame < 150 else np.array([0.0, 0.0, -0.5])
        poses.append(odometry.pose)
        twists.append(twist)
        odometry.step(twist, DT)
    return np.array(twists), np.array(poses)


def followed(twists, path, start, wrong):
    """Pose after a replay in which the base does not quite do what it is told: wrong(frame, twist)."""
    odometry = Odometry()
    odometry.pose = np.array(start)
    for frame, twist in enumerate(twists):
        asked = path.correct(twist, at(odometry.pose)) if path is not None else twist
        odometry.step(wrong(frame, asked), DT)
    return odometry.pose


def from_start(poses, start):
    """Where the recorded way ends if it begins at `start`."""
    s, c = np.sin(start[2] - poses[0, 2]), np.cos(start[2] - poses[0, 2])
    way = poses[-1] - poses[0]
    return np.array(start) + [c * way[0] - s * way[1], s * way[0] + c * way[1], way[2]]


@pytest.mark.parametrize("start", [[1.0, -2.0, 0.7], [0.0, 0.0, 0.0], [-3.0, 1.0, 2.5]])
@pytest.mark.parametrize(
    "wrong",
    [
        lambda frame, twist: twist * 0.95,
        lambda frame, twist: np.zeros(3) if 60 <= frame < 75 else twist,
        lambda frame, twist: twist + np.array([0.0, 0.02, 0.01]),
    ],
    ids=["slow", "late", "crooked"],
)
def test_what_is_missed_is_made_up(start, wrong):
    twists, poses = recorded()
    end = from_start(poses, start)
    with_poses = np.abs(followed(twists, ReplayedPath(poses), start, wrong) - end)
    without = np.abs(followed(twists, None, start, wrong) - end)
    assert with_poses.max() < 0.04 and np.linalg.norm(with_poses) < 0.4 * np.linalg.norm(without)


def test_a_faithful_base_gets_the_recorded_velocities():
    twists, poses = recorded()
    path = ReplayedPath(poses)
    for twist, pose in zip(twists, poses, strict=True):
        assert path.correct(twist, at(pose)) == pytest.approx(twist)


def test_the_correction_is_limited():
    twists, poses = recorded()
    path = ReplayedPath(poses)
    path.correct(twists[0], at(poses[0]))
    correction = path.correct(twists[1], at(poses[1] + [9.0, 9.0, 9.0])) - twists[1]
    assert np.abs(correction) == pytest.approx([0.15, 0.15, 0.4])


def test_a_rail_that_is_driven_by_velocity_keeps_its_recorded_height():
    path = ReplayedPath(np.zeros((3, 3)), np.array([0.3, 0.31, 0.9]))
    heights = [path.correct(np.array([0.0, 0.0, 0.0, 0.2]), at(np.zeros(3), 0.3))[3] for _ in range(3)]
    assert heights == pytest.approx([0.2, 0.21, 0.3])
