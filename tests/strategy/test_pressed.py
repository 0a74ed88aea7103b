"""A take-over by a button, from the handle to the follower, in lock-step: the strategy looks ten times a second."""

import numpy as np
import pytest

from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_strategy_yam.take_over import TakeOverSignals
from tests.face.devices.test_coupled_devices import coupled, state_of
from tests.support.coupled import LEADER, POSE
from tests.support.rigged import rig_of
from tests.support.strategy_here import HereConfig

FRAME_S = 0.1


@pytest.fixture(scope="module")
def rig():
    with rig_of("lockstep") as rig:
        yield rig


@pytest.fixture(scope="module")
def pair(rig, tmp_path_factory):
    with coupled(rig, tmp_path_factory.mktemp("pressed")) as devices:
        yield devices


def look(signals, pair):
    """One frame of a strategy; the policy wants to stay."""
    device, robot = pair
    taken, _ = signals.look()
    robot.clock.sleep(0.02)  # the policy thinks
    person, policy = device.get_action(), robot.action_for(np.append(POSE + 0.1, 0.5))
    robot.send_action(person if taken else policy)
    return taken


@pytest.mark.parametrize("take_over", ["toggle", "hold"])
def test_the_arm_is_the_persons_before_the_strategy_knows(rig, pair, take_over):
    device, robot = pair
    clock = robot.clock
    signals = TakeOverSignals(device, HereConfig(take_over=take_over))
    assert look(signals, pair) == set()
    clock.sleep(0.05)
    assert not state_of(robot).coupled
    rig.press(LEADER, "record", 0.01 if take_over == "toggle" else 0.25)
    clock.sleep(0.02)
    assert state_of(robot).coupled
    clock.sleep(FRAME_S - 0.07)
    assert look(signals, pair) == {""} == signals.pressed
    clock.sleep(FRAME_S)
    assert state_of(robot).coupled
    assert look(signals, pair) == {""} and signals.pressed == set()
    if take_over == "toggle":
        rig.press(LEADER, "record", 0.01)
    clock.sleep(FRAME_S)
    assert look(signals, pair) == set() == signals.pressed
    clock.sleep(0.02)
    assert not state_of(robot).coupled


def test_a_press_during_an_emergency_stop_takes_nothing_over(rig, pair):
    robot = pair[1]
    signals, stop = TakeOverSignals(pair[0], HereConfig()), EmergencyStop()
    look(signals, pair)
    stop.latch("a test")
    try:
        robot.clock.sleep(0.05)
        rig.press(LEADER, "record", 0.02)
        robot.clock.sleep(0.05)
        assert look(signals, pair) == set()
    finally:
        stop.release()
    robot.clock.sleep(0.1)
    assert look(signals, pair) == set()
    robot.clock.sleep(0.02)
    assert not state_of(robot).coupled
