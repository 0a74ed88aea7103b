"""The operator's view of the rig."""

import math

import numpy as np
import pytest

from lerobot_robot_yam.rig.operator.hands import sight_of
from lerobot_robot_yam.rig.simulation.rig_operations import RigOperations
from tests.support.rigged import lockstep_rig

ON_ITS_FACE = np.array([math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0])  # a quarter turn about y: the x axis points down


def seen(rig: RigOperations):
    return sight_of(rig.state(), ("left", "right"))


rig = lockstep_rig("follower_left", "follower_right", scene="drawer")


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
