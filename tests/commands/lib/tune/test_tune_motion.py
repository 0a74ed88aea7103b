"""Ways that tell an arm's weight and hit nothing."""

import numpy as np
import pytest

from lerobot_robot_yam.arm.collision.workspace import KeepOut, WorkspaceConfig
from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.commands.lib.tune.gravity_terms import GravityTerms
from lerobot_robot_yam.commands.lib.tune.tune_motion import MARGIN_M, WAIT_S, Route, way_s
from lerobot_robot_yam.commands.tune import LEGS
from lerobot_robot_yam.errors import ConfigError
from tests.support.tiers import spread

MOST_S = 100.0
SAFE = WorkspaceConfig(floor_z_m=MARGIN_M, collision_margin_m=MARGIN_M)


def route_of(workspace=SAFE, **fields):
    hardware = ResolvedArm(ArmConfig(name="left", channel="can0", **fields))
    terms = GravityTerms(hardware.arm, hardware.gripper, tilt_rad=hardware.tilt_rad)
    return hardware, Route(hardware, terms, workspace)


@pytest.mark.parametrize("arm, gripper", spread([("yam", "linear_4310"), ("big_yam", "crank_4310")], 0))
def test_each_way_is_short_and_clear(arm, gripper):
    hardware, route = route_of(arm=arm, gripper=gripper)
    poses = route.plan(hardware.rest_q, LEGS)
    route.check([hardware.rest_q, *poses, *poses[::-1]])
    low, high = hardware.arm.joint_limits_rad.T
    assert poses.shape == (LEGS + 1, 6) and (poses > low).all() and (poses < high).all()
    assert (np.abs(np.diff(poses, axis=0)).max(axis=0) > 0.3).all()  # every joint moves
    assert sum(2.0 * (way_s(a, b) + WAIT_S) for a, b in zip(poses, poses[1:], strict=False)) < MOST_S
    assert (np.abs(poses[:, 0]) <= 0.6).all()  # the base turns a little


def test_a_way_through_the_table_is_refused_with_what_would_hit_it():
    hardware, route = route_of()
    up, down = [0.0, 1.2, 1.2, 0.0, 0.0, 0.0], [0.0, 2.9, 1.4, 0.0, 0.0, 0.0]
    with pytest.raises(ConfigError, match=r"left: on the way to pose 2 left \w+ would come within 0 mm of .*floor"):
        route.check([hardware.rest_q, np.array(up), np.array(down)])


def test_without_any_clear_way_the_arm_is_not_moved():
    boxed = WorkspaceConfig(keep_out=[KeepOut(name="lid", center_m=[0.0, 0.0, 0.5], size_m=[2.0, 2.0, 0.5])])
    hardware, route = route_of(boxed)
    with pytest.raises(ConfigError, match="left: no pose can be reached from"):
        route.plan(hardware.rest_q, LEGS)
