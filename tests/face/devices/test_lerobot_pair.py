"""Promises that LeRobot's loops rely on, asked of one connected pair of devices that each test leaves as it was."""

import functools
import math

import numpy as np
import pytest
import torch
from lerobot.utils.errors import DeviceAlreadyConnectedError

from lerobot_robot_yam.errors import ActionError
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from tests.face.devices import test_lerobot_contract as contract
from tests.face.devices.test_lerobot_contract import BI_KEYS, connected_pair, enabled
from tests.support.rigged import rig_of
from tests.support.tiers import spread


@pytest.fixture(scope="module")
def shared_rig():
    with rig_of("lockstep") as rig:
        yield rig


@pytest.fixture(scope="module")
def pair(shared_rig, tmp_path_factory):
    with connected_pair(shared_rig, tmp_path_factory.mktemp("calibration")) as devices:
        yield devices


@pytest.fixture
def follower(pair):
    return pair[0]


@pytest.fixture
def leader(pair):
    return pair[1]


@pytest.fixture
def clock(follower):
    return follower.clock


@pytest.fixture
def settle(clock):
    return functools.partial(contract.settle, clock=clock)


def test_observation_is_as_announced(follower):
    observation = follower.get_observation()
    assert list(observation) == list(follower.observation_features)
    assert all(type(value) is float and math.isfinite(value) for value in observation.values())


def test_connecting_twice_is_refused(follower):
    with pytest.raises(DeviceAlreadyConnectedError):
        follower.connect()


def test_leader_action_fits_the_follower(follower, leader):
    action = leader.get_action()
    assert list(action) == list(follower.action_features)
    assert follower.send_action(action) == pytest.approx(action)  # recorded = sent


def test_targets_are_reached_and_clipped_to_the_limits(follower, shared_rig, settle):
    start = follower.get_observation()
    action = {**start, "left_joint_1.pos": 0.2, "right_gripper.pos": 0.5, "left_joint_2.pos": -1.0}
    sent = settle(follower.send_action, action)
    assert sent["left_joint_2.pos"] == 0.0 and sent["left_joint_1.pos"] == pytest.approx(0.2)
    assert list(sent) == BI_KEYS
    arms = shared_rig.state()["arms"]
    assert arms["follower_left"]["q"][0] == pytest.approx(0.2, abs=0.01)
    assert arms["follower_right"]["opening"] == pytest.approx(0.5, abs=0.03)
    assert follower.get_observation()["left_joint_1.pos"] == pytest.approx(0.2, abs=0.01)


def test_tensors_are_numbers(follower):
    """lerobot-replay sends 0-d torch tensors."""
    action = {key: torch.tensor(value) for key, value in follower.get_observation().items()}
    assert all(type(value) is float for value in follower.send_action(action).values())


@pytest.mark.parametrize(
    "change",
    [
        {"left_joint_1.pos": math.nan},
        {"right_gripper.pos": math.inf},
        {"left_joint_1.pos": "far"},
        {"left_joint_1.pos": None},
        {"left_joint_1.pos": np.zeros(2)},
        {"left_joint_1.pos": torch.zeros(2)},
        {"joint_1.pos": 0.0},
        {"left_joint_3.pos": ...},  # left out
    ],
)
def test_bad_actions_reach_no_arm(follower, change, clock):
    observation = follower.get_observation()
    action = {key: value + 0.3 for key, value in observation.items()} | change
    action = {key: value for key, value in action.items() if value is not ...}
    with pytest.raises(ActionError, match=next(iter(change))):
        follower.send_action(action)
    clock.sleep(0.1)
    assert follower.get_observation() == pytest.approx(observation, abs=0.01)


def test_the_trigger_closes_the_gripper_and_silence_keeps_it(leader, shared_rig, clock):
    shared_rig.trigger("leader_left", 0.7)
    clock.sleep(0.2)
    assert leader.get_action()["left_gripper.pos"] == pytest.approx(0.3, abs=0.02)
    assert leader.get_action()["right_gripper.pos"] == pytest.approx(1.0, abs=0.02)
    shared_rig.fault("leader_left", None, "handle_silent", True)
    clock.sleep(0.5)
    shared_rig.trigger("leader_left", 0.0)
    action = leader.get_action()
    assert action["left_gripper.pos"] == pytest.approx(0.3, abs=0.02)
    assert math.isfinite(action["left_joint_1.pos"])
    shared_rig.clear_faults("leader_left")
    clock.sleep(0.3)
    assert leader.get_action()["left_gripper.pos"] == pytest.approx(1.0, abs=0.02)


def test_leader_action_keeps_the_followers_limits(leader, shared_rig, clock):
    """At rest, measured joints 2 and 3 lie on their limits, on either side of them."""
    q = shared_rig.state()["arms"]["leader_left"]["q"]
    shared_rig.hand("leader_left", [0.5], [[q[0], -0.2, *q[2:6]]])  # pull joint 2 into its stop
    seen = []
    for _ in range(50):
        seen.append(leader.get_action()["left_joint_2.pos"])
        clock.sleep(0.02)
    shared_rig.release("leader_left")
    assert min(seen) == 0.0


def test_followers_hold_while_a_leader_is_led_whatever_lerobot_repeats(follower, leader, settle, clock):
    """DAgger on a pause: the leader is held and led for 2 s, then the policy's last action is sent again and again."""
    start = follower.get_observation()
    lunge = {**start, "left_joint_1.pos": start["left_joint_1.pos"] + 1.5}
    settle(follower.send_action, start, 0.3)
    settle(follower.send_action, lunge, 0.2)
    leader.enable_torque()
    clock.sleep(0.7)  # longer than the command time-out
    held = follower.get_observation()["left_joint_1.pos"]
    assert held < lunge["left_joint_1.pos"] - 0.5
    sent = settle(follower.send_action, lunge, 0.5)
    assert follower.get_observation()["left_joint_1.pos"] == pytest.approx(held, abs=0.02)
    assert sent["left_joint_1.pos"] == pytest.approx(held, abs=0.02)  # what is recorded is what is done
    leader.disable_torque()
    settle(follower.send_action, lunge)  # going on with the same action is a wish now
    assert follower.get_observation()["left_joint_1.pos"] == pytest.approx(lunge["left_joint_1.pos"], abs=0.02)
    settle(follower.send_action, start)


def test_feedback_to_a_leader_that_floats_after_an_emergency_stop_is_ignored(leader, settle, clock):
    action = leader.get_action()
    leader.enable_torque()
    stop = EmergencyStop()
    try:
        stop.latch("a test")
        clock.sleep(0.2)
    finally:
        stop.release()
    clock.sleep(0.2)
    settle(leader.send_feedback, {**action, "left_joint_1.pos": action["left_joint_1.pos"] + 0.3}, 0.5)
    assert leader.get_action()["left_joint_1.pos"] == pytest.approx(action["left_joint_1.pos"], abs=0.05)
    leader.disable_torque()


def test_feedback_leads_the_leader_only_while_torque_is_enabled(leader, shared_rig, settle):
    action = leader.get_action()
    goal = {**action, "left_joint_1.pos": action["left_joint_1.pos"] + 0.3}
    settle(leader.send_feedback, goal, 0.5)
    assert leader.get_action()["left_joint_1.pos"] == pytest.approx(action["left_joint_1.pos"], abs=0.05)
    leader.enable_torque()
    with pytest.raises(ActionError):
        leader.send_feedback({"left_joint_1.pos": 0.0})
    settle(leader.send_feedback, goal)
    assert leader.get_action()["left_joint_1.pos"] == pytest.approx(goal["left_joint_1.pos"], abs=0.02)
    leader.disable_torque()
    settle(leader.send_feedback, action, 0.5)
    assert leader.get_action()["left_joint_1.pos"] == pytest.approx(goal["left_joint_1.pos"], abs=0.1)
    assert all(enabled(shared_rig, "leader_left"))  # it floats, it is not limp


def test_a_trigger_takes_over_where_feedback_has_left_the_gripper(leader, shared_rig, settle):
    def opening(trigger):
        shared_rig.trigger("leader_left", trigger)
        return settle(lambda _: leader.get_action(), None, 0.3)["left_gripper.pos"]

    assert opening(0.0) == 1.0
    held = {**leader.get_action(), "left_gripper.pos": 0.4}  # the follower has something in its hand
    leader.enable_torque()
    settle(leader.send_feedback, held, 0.3)
    leader.disable_torque()
    assert opening(0.0) == opening(0.3) == 0.4  # it is not dropped
    assert opening(0.7) == pytest.approx(0.3, abs=0.02)  # picked up
    assert opening(0.0) == 1.0


def test_a_correction_without_a_handover_goes_by_the_trigger(leader, shared_rig, settle):
    shared_rig.trigger("leader_left", 0.0)
    leader.enable_torque()
    settle(leader.send_feedback, {**leader.get_action(), "left_gripper.pos": 0.4}, 0.3)
    leader.disable_torque()
    assert leader.get_action()["left_gripper.pos"] == 0.4
    leader.disable_torque()  # of the next correction, with --strategy.smooth_handover=false: long after
    assert settle(lambda _: leader.get_action(), None, 0.3)["left_gripper.pos"] == 1.0


@pytest.mark.parametrize("led", spread([True, False], 1))
def test_a_trigger_that_is_let_go_of_while_the_leader_holds_opens_nothing(leader, shared_rig, led, settle, clock):
    def opening(trigger):
        shared_rig.trigger("leader_left", trigger)
        return settle(lambda _: leader.get_action(), None, 0.3)["left_gripper.pos"]

    gripped = 0.4 if led else opening(0.6)
    opening(1.0 if led else 0.6)
    leader.enable_torque()
    if led:
        settle(leader.send_feedback, {**leader.get_action(), "left_gripper.pos": gripped}, 0.3)
    shared_rig.trigger("leader_left", 0.0)
    clock.sleep(0.3)
    leader.disable_torque()
    assert leader.get_action()["left_gripper.pos"] == gripped == opening(0.0)
    assert opening(0.7) == pytest.approx(0.3, abs=0.02)  # picked up
    assert opening(0.0) == 1.0


def test_during_an_emergency_stop_the_last_action_stays(leader, shared_rig, clock):
    """The followers hold, and what is recorded says so."""
    stop, before = EmergencyStop(), leader.get_action()
    stop.latch("a test")
    try:
        clock.sleep(0.1)
        shared_rig.trigger("leader_left", 0.8)
        clock.sleep(0.3)
        assert leader.get_action() == before
    finally:
        stop.release()
    clock.sleep(0.1)
    assert leader.get_action()["left_gripper.pos"] == pytest.approx(0.2, abs=0.02)
    shared_rig.trigger("leader_left", 0.0)
