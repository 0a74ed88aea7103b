"""Masses that an arm's profile knows nothing of."""

import contextlib

import mujoco
import numpy as np
import pytest

from lerobot_robot_yam.arm.dynamics import GravityModel
from tests.support.rig_desk import Desk

CHANNEL = "follower_left"
LIFTED = np.array([0.0, 1.2, 1.0, 0.2, 0.0, 0.0])


def standing_torque(desk, q):
    """Torque that holds the arm's joints at q (6,), from the world's own model."""
    world = desk.device.world
    data = mujoco.MjData(world.model)
    data.qpos[:] = world.data.qpos
    data.qpos[world.joint_addresses(CHANNEL)] = q
    mujoco.mj_forward(world.model, data)
    return data.qfrc_bias[world.joint_dofs(CHANNEL)]


def test_a_payload_pulls_as_a_mass_at_the_tool_does(desk):
    model = desk.device.world.model
    plain = standing_torque(desk, LIFTED)
    assert plain == pytest.approx(GravityModel("yam", "linear_4310").torque(LIFTED), abs=0.05)
    desk.fault(CHANNEL, None, "payload_kg", 0.8)
    loaded = standing_torque(desk, LIFTED)
    data = mujoco.MjData(model)
    data.qpos[:] = desk.device.world.data.qpos
    data.qpos[desk.device.world.joint_addresses(CHANNEL)] = LIFTED
    mujoco.mj_forward(model, data)
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jacSite(model, data, jacobian, None, model.site(f"{CHANNEL}/tcp_site").id)
    weight = jacobian.T @ [0.0, 0.0, 0.8 * 9.81]
    assert loaded - plain == pytest.approx(weight[desk.device.world.joint_dofs(CHANNEL)], abs=1e-3)
    assert np.abs(loaded - plain).max() > 1.0
    desk.clear_faults(CHANNEL)
    assert standing_torque(desk, LIFTED) == pytest.approx(plain)


@pytest.mark.parametrize("channel", ["follower_left", "leader_left"])
def test_a_hand_is_a_ball_of_its_mass_at_the_tool(channel):
    """By what it adds to the arm's mass matrix:  m Jᵀ J + m r² Wᵀ W."""
    mass_kg, gyration_m = 1.5, 0.06
    with contextlib.closing(Desk(channel)) as desk:
        world, model = desk.device.world, desk.device.world.model
        matrices, (jacobian, turns) = np.zeros((2, model.nv, model.nv)), np.zeros((2, 3, model.nv))
        for matrix, kg in zip(matrices, (0.0, mass_kg), strict=True):
            desk.device.ballast[channel].hold(kg, gyration_m)
            data = mujoco.MjData(model)
            data.qpos[:] = world.data.qpos
            data.qpos[world.joint_addresses(channel)] = LIFTED
            mujoco.mj_forward(model, data)
            mujoco.mj_fullM(model, data, matrix)
        mujoco.mj_jacSite(model, data, jacobian, turns, model.site(f"{channel}/tcp_site").id)
        added = mass_kg * (jacobian.T @ jacobian + gyration_m**2 * turns.T @ turns)
        np.testing.assert_allclose(matrices[1] - matrices[0], added, atol=1e-9)
