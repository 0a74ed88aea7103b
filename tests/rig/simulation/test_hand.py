"""The operator's hand on a leader joins a path that begins elsewhere without a snatch, calms what it holds, and presses
buttons.
"""

import numpy as np
import pytest

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.world.world_model import HAND_KP
from tests.support.rig_desk import Desk
from tests.support.rigged import lockstep_rig

LEADER = "leader_left"
ARMS = [LEADER, "follower_left"]
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


rig = lockstep_rig(*ARMS)


def edges(rig):
    return [(event["button"], event["down"]) for event in rig.events() if event["kind"] == "button"]


def test_a_press_ends_by_itself(rig):
    rig.press(LEADER, "record", 0.1)
    assert rig.state()["arms"][LEADER]["buttons"] == [False, True]
    rig.sleep(0.5)
    assert rig.state()["arms"][LEADER]["buttons"] == [False, False]
    assert edges(rig) == [("record", True), ("record", False)]


def test_a_button_that_is_held_stays_down_after_a_press_of_the_other(rig):
    rig.buttons(LEADER, sync=True)
    rig.press(LEADER, "record", 0.02)
    rig.sleep(0.4)
    assert rig.state()["arms"][LEADER]["buttons"] == [True, False]
    rig.buttons(LEADER)
    assert edges(rig) == [("sync", True), ("record", True), ("record", False), ("sync", False)]


def test_a_press_lasts_as_long_as_was_asked(rig):
    rig.press(LEADER, "sync", 0.1)
    rig.sleep(0.05)
    rig.press(LEADER, "sync", 0.1)  # once more, before the first has ended: no second edge
    rig.sleep(0.5)
    down, up = (event["sim_s"] for event in rig.events() if event["kind"] == "button")
    assert up - down == pytest.approx(0.15, abs=0.01)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("leader_left", "top", 0.1), "sync, record"),
        (("leader_left", "sync", float("nan")), "finite"),
        (("leader_left", "sync", -1.0), "from 0.005"),
        (("leader_left", "sync", "long"), "finite number"),
        (("leader_middle", "sync", 0.1), "no channel 'leader_middle'"),
        (("follower_left", "sync", 0.1), "no teaching handle"),
    ],
)
def test_what_a_press_refuses(rig, arguments, message):
    with pytest.raises(ConfigError, match=message):
        rig.press(*arguments)
    assert edges(rig) == []
