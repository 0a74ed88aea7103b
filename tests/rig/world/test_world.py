"""Physics of the world, without real time."""

import numpy as np
import pytest

from lerobot_robot_yam.rig.scene.scene import load_scene
from lerobot_robot_yam.rig.simulation.device import RigDevice
from lerobot_robot_yam.rig.world.world import World
from lerobot_robot_yam.rig.world.world_model import world_dtype


def test_time_given_up_after_a_stall_is_a_slip_and_not_a_burst():
    world = World(load_scene(options={"arms": ["leader_left"]}))
    world.start(10.0)
    assert world.due(10.0105) == 10
    world.step(10)
    assert world.due(11.0) == 0
    assert world.slips == 1
    assert world.due(11.0045) == 4
    assert world.sim_s == pytest.approx(0.01)


def test_every_process_builds_the_same_world():
    one, other = World(load_scene()), World(load_scene())
    assert world_dtype(one.model) == world_dtype(other.model)
    for world in (one, other):
        world.step(200)
    np.testing.assert_array_equal(one.data.qpos, other.data.qpos)


def test_arms_rest_and_the_cube_lies_still_without_torque():
    device = RigDevice(load_scene())
    device.world.start(0.0)
    world = device.world
    before = world.data.xpos.copy()
    for now in np.arange(0, 2, 0.02):
        device.advance(now)
    assert np.abs(world.data.xpos - before).max() < 0.01


def test_arms_do_not_fall_through_the_table():
    world = World(load_scene(options={"arms": ["follower_left"], "friction": 0}))
    world.set_pose("follower_left", np.array([0.0, 2.2, 1.2, 0.0, 0.0, 0.0]))
    world.step(3000)
    assert world.data.site("follower_left/tcp_site").xpos[2] > -0.01
    assert np.abs(world.data.qvel).max() < 0.5


def test_friction_and_armature_are_factors_on_the_profile():
    plain, none = (World(load_scene(options={"friction": f, "armature": f or 0.5})).model for f in (1.0, 0.0))
    joint = "follower_left/joint4"
    assert plain.joint(joint).frictionloss[0] > 0
    assert none.joint(joint).frictionloss[0] == 0
    ratio = none.dof_armature[none.joint(joint).dofadr[0]] / plain.dof_armature[plain.joint(joint).dofadr[0]]
    assert ratio == pytest.approx(0.5)
