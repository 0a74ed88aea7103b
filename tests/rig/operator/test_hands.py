"""The operator's view of the rig."""

import math

import numpy as np
import pytest

from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.rig.operator.hands import Pose, sight_of
from lerobot_robot_yam.rig.simulation.rig_operations import RigOperations
from lerobot_robot_yam.rig.world.world_model import yaw_quat

ON_ITS_FACE = np.array([math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0])  # a quarter turn about y: the x axis points down


def seen(rig: RigOperations):
    return sight_of(rig.state(), ("left", "right"))


@pytest.fixture
def rig():
    rig = LockstepRig("drawer", arms=["follower_left", "follower_right"])
    yield rig
    rig.close()


def test_a_pose_has_points_and_a_direction():
    pose = Pose(np.array([1.0, 2.0, 3.0]), yaw_quat(2.5))
    assert pose.yaw_rad == pytest.approx(2.5) and pose.edge_yaw_rad % (np.pi / 2) == pytest.approx(2.5 % (np.pi / 2))
    assert pose.point(np.array([1.0, 0.0, 0.5])) == pytest.approx([1 + math.cos(2.5), 2 + math.sin(2.5), 3.5])


def test_an_edge_is_seen_whichever_face_it_lies_on():
    pose = Pose(np.zeros(3), ON_ITS_FACE)
    assert pose.edge_yaw_rad % (np.pi / 2) == pytest.approx(0.0, abs=1e-9)


def test_without_leaders_the_followers_are_both_and_limp_arms_are_not_willing(rig):
    sight = seen(rig)
    assert set(sight.things) == {"table", "drawer", "cabinet"} and sight.joints == {"drawer": 0.0}
    for side in ("left", "right"):
        np.testing.assert_array_equal(sight.leader_rad[side], sight.follower_rad[side])
        assert sight.follower_rad[side] == pytest.approx(rig.state()["arms"][f"follower_{side}"]["q"])
        assert sight.opening[side] == pytest.approx(rig.state()["arms"][f"follower_{side}"]["opening"])
    assert not sight.willing


def test_furniture_is_seen_to_move(rig):
    before = seen(rig)
    rig.task("drawer", seed=0)
    after = seen(rig)
    assert after.joints["drawer"] > 0.0
    assert np.linalg.norm(after.things["drawer"].position_m - before.things["drawer"].position_m) > 0.005
