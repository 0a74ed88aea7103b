"""A coupled follower in mid-motion whose leader fails, or that fails itself: as docs/faults.md says."""

import contextlib

import numpy as np
import pytest

from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.errors import MotorError
from lerobot_robot_yam.state.faults import RESPONSES, Response, Trouble
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Limited
from scripts import recorders
from tests.support.coupled import FOLLOWER, POSE
from tests.support.published_leader import LedFollower
from tests.support.rigged import lockstep_rig
from tests.support.tiers import spread

rig = lockstep_rig(FOLLOWER)
STEP_RAD_S = 0.1  # within 10 ms


@pytest.fixture
def led(rig):
    with contextlib.closing(LedFollower(rig)) as led:
        yield led


def steps(rig):
    speeds = recorders.truth(rig, FOLLOWER)["dq"][:, :6]
    return np.abs(speeds[10:] - speeds[:-10]).max()


LOST = {
    "its process is gone, and its block": LedFollower.remove_leader,
    "its loop hangs": lambda led: setattr(led, "publishes", False),
    "its motor is silent": lambda led: setattr(led, "samples", False),
    "it has failed": lambda led: (setattr(led, "mode", Mode.FAULT), setattr(led, "asks", False)),
    "a stand-by lands it": lambda led: (setattr(led, "mode", Mode.LAND), setattr(led, "asks", False)),
    "it has no target": lambda led: setattr(led, "asks", False),
}


@pytest.mark.parametrize("how", spread(LOST, 2))
def test_a_follower_whose_leader_is_lost_brakes_smoothly_and_waits(rig, led, how):
    rule = RESPONSES[Trouble.LEADER_LOST]
    assert rule.arm is Response.HOLD_UNTIL_TARGET
    recorders.truth_start(rig, FOLLOWER, 5.0)
    LOST[how](led)
    led.passes = False  # whoever calls for the leader's action gets an error instead
    led.run(rule.within_s)
    assert not led.states[-1].coupled and led.states[-1].mode is Mode.TRACK
    led.run(1.0)
    assert steps(rig) < STEP_RAD_S
    state = led.states[-1]
    assert state.mode is Mode.HOLD and Limited.COMMAND_TIMEOUT in state.limited and state.trouble is None
    there = state.setpoint_q
    led.run(0.3)
    assert np.abs(led.states[-1].setpoint_q - there).max() < 1e-6
    assert np.abs(there - POSE).max() < 0.35


def test_a_leader_that_tells_again_is_followed_again_without_a_jolt(rig, led):
    recorders.truth_start(rig, FOLLOWER, 5.0)
    led.publishes = led.passes = False
    led.run(0.2)
    assert not led.states[-1].coupled
    led.publishes = led.passes = True
    led.run(2.0)
    assert led.states[-1].coupled
    assert steps(rig) < STEP_RAD_S
    assert np.abs(led.states[-1].setpoint_q - led.target()[0]).max() < 0.02


def test_a_follower_that_is_armed_again_joins_its_leader_without_a_leap(rig, led):
    rig.fault(FOLLOWER, "joint_4", "nibble", int(Fault.OVER_CURRENT))
    with pytest.raises(MotorError, match="joint_4"):
        led.run(0.2)
    led.passes = False
    led.run(0.8)
    assert led.states[-1].mode is Mode.FAULT and not led.states[-1].coupled
    led.session.rearm()
    led.run(0.2)
    assert led.states[-1].mode is Mode.HOLD and not led.states[-1].coupled  # nobody has passed an action on yet
    first = len(led.states)
    recorders.truth_start(rig, FOLLOWER, 5.0)
    led.passes = True
    led.run(2.0)
    assert led.states[-1].coupled and led.states[-1].trouble is None
    q = np.array([state.setpoint_q for state in led.states[first:]])
    stamps = np.array([state.published_s for state in led.states[first:]])
    assert (np.abs(np.diff(q, axis=0)) / np.diff(stamps)[:, None]).max() <= 1.5 * 1.001
    assert steps(rig) < 0.35  # joint_4 has sunk, and is fetched back with 30 rad/s²
    assert np.abs(led.states[-1].setpoint_q - led.target()[0]).max() < 0.02
