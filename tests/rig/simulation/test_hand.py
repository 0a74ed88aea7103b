"""The operator's hand on a leader joins a path that begins elsewhere without a snatch, and calms what it holds."""

import numpy as np
import pytest

from lerobot_robot_yam.rig.world.world_model import HAND_KP
from tests.support.rig_desk import Desk

LEADER = "leader_left"
RAISED = np.array([0.0, 1.2, 1.0, 0.0, 0.0, 0.0])
TURN = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])  # rad; the wrist is the lightest joint


@pytest.fixture
def desk():
    desk = Desk(LEADER)
    desk.device.world.set_pose(LEADER, RAISED)
    desk.device.world.refresh()
    yield desk
    desk.close()


def joints(desk):
    return np.array([desk.device.world.qpos[address] for address in desk.device.world.joint_addresses(LEADER)])


def fastest(desk, seconds):
    """The largest speed of a joint while time passes, rad/s."""
    found = 0.0
    for _ in range(round(seconds / 0.004)):
        desk.run(0.004)
        found = max(found, *(abs(desk.device.world.qvel[dof]) for dof in desk.device.world.joint_dofs(LEADER)))
    return found


def test_a_path_that_begins_at_the_end_of_one_the_clock_did_not_reach(desk):
    """An operator that plans by real time believes that the hand has arrived."""
    hand, end = desk.device.hands[LEADER], RAISED + TURN
    hand.move([0.0, 1.0], [RAISED, end], 0.0)
    desk.run(0.2)
    desk.now_s += 0.8
    desk.run(0.004)
    assert desk.device.world.slips == 1 and np.abs(joints(desk) - end).max() > 0.7
    hand.move([0.0, 0.3], [end, end], 0.0)
    assert fastest(desk, 1.0) < 2.2
    np.testing.assert_allclose(joints(desk), end, atol=0.05)


def test_a_path_that_begins_where_the_arm_was_before_the_hand_took_hold(desk):
    seen = RAISED + TURN
    desk.device.hands[LEADER].move([0.0, 1.0], [seen, seen + 0.5 * TURN], 0.0)
    assert fastest(desk, 2.0) < 2.5
    np.testing.assert_allclose(joints(desk), seen + 0.5 * TURN, atol=0.05)


def test_a_hand_that_takes_hold_of_a_resting_arm_does_not_push(desk):
    here = joints(desk)
    hand = desk.device.hands[LEADER]
    hand.move([0.0, 1.0], [here + 1e-6, here], 0.0)  # what was seen of it is rounded
    hand.advance(energised=True)
    pulls = desk.device.world.data.ctrl[hand._firm.actuators]
    np.testing.assert_allclose(pulls, HAND_KP * here, atol=0.1)  # where it is, at rest


@pytest.mark.parametrize("blow_rad_s", [1.7, 2.6])
def test_a_blow_that_takes_all_of_the_hands_force_dies_away(desk, blow_rad_s):
    """A damper at its limit of force must not throw a light wrist to and fro with each step of the physics."""
    here, world = joints(desk), desk.device.world
    desk.device.hands[LEADER].move([0.0, 1.0], [here, here], 0.0)
    desk.run(0.1)
    world.data.qvel[world.joint_dofs(LEADER)] = blow_rad_s * np.array([0, 0, 0, 0, 1, 1])
    desk.run(0.5)
    assert fastest(desk, 0.1) < 0.01
    np.testing.assert_allclose(joints(desk), here, atol=0.05)
