"""A coupled follower in mid-motion whose leader fails, or that fails itself: as docs/faults.md says."""

import contextlib
import os

import numpy as np
import pytest

from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.errors import MotorError
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.state.faults import RESPONSES, Response, Trouble
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import STATE_DTYPE, Limited, channel_key, state_path
from lerobot_robot_yam.system.shared_block import SharedBlock
from scripts import recorders
from tests.support.coupled import FOLLOWER, LEADER, POSE, arm_config
from tests.support.rigged import lockstep_rig
from tests.support.tiers import spread

TICK_S, FRAME_S = 0.004, 1 / 30


class LedFollower:
    """A follower in lock-step, under way at a leader of which there is only its published state. Then `run`.

    The leader swings all joints about POSE.

    Attributes:
        publishes: the leader's loop publishes its state.
        mode, asks, samples: it is in this mode, has a target for its follower, hears its motors.
        passes: a caller passes the leader's action on.
        states: of the follower, of each tick.
    """

    def __init__(self, rig):
        self.session = ArmSession([arm_config(rig, FOLLOWER)], isolation="lockstep")
        self.session.start()
        self._key = channel_key("yam_lockstep", LEADER, rig.name)
        self._block = SharedBlock(state_path(self._key), STATE_DTYPE, create=True)
        self._begin_s = self._heard_s = self._next_s = self.session.clock.now()
        self.mode, self.asks, self.samples, self.publishes, self.passes = Mode.FLOAT, True, True, True, True
        self.states = []
        self.run(3.3)  # the swing is at its fastest
        assert self.states[-1].coupled and np.abs(self.states[-1].dq).max() > 0.8

    @property
    def follower(self):
        """Its client."""
        return self.session[FOLLOWER]

    def target(self, at_s=None):
        """Joints (6,) where the leader is at a time, by default now, and their speed."""
        t = (self.session.clock.now() if at_s is None else at_s) - self._begin_s
        wave = 0.3 * min(t, 1.0)
        phase = np.pi * (t - 3.3)
        return POSE + wave * np.sin(phase), np.full(6, wave * np.pi * np.cos(phase) if t > 1.0 else 0.0)

    def run(self, seconds):
        """Let time pass tick by tick."""
        clock = self.session.clock
        until_s = clock.now() + seconds
        while clock.now() < until_s:
            if self.publishes:
                self._publish(clock.now())
            if self.passes and clock.now() >= self._next_s:
                self._next_s = clock.now() + FRAME_S
                self.follower.write_target(self.target()[0], 0.5, leader=self._key)
            clock.sleep(TICK_S)
            self.states.append(self.follower.published())

    def _publish(self, now):
        record = np.zeros((), STATE_DTYPE)
        record["owner_pid"], record["stamp_s"], record["mode"] = os.getpid(), now, self.mode
        record["action"] = record["action_dq"] = np.nan
        if self.samples:
            self._heard_s = now
        record["action_stamp_s"] = self._heard_s
        if self.asks:
            record["action"][:6], record["action_dq"][:6] = self.target(self._heard_s)
            record["action"][6], record["action_dq"][6] = 0.5, 0.0
        self._block.write(record)

    def remove_leader(self):
        """Its block goes, as when its process has ended."""
        self.publishes = False
        self._block.close()

    def close(self):
        self._block.close()
        self.session.discard()


rig = lockstep_rig(FOLLOWER)
BRAKING_RAD_S = 0.4  # within 10 ms: 30 rad/s², and the arm's answer to their beginning


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
def test_a_follower_whose_leader_is_lost_brakes_at_once_and_waits(rig, led, how):
    rule = RESPONSES[Trouble.LEADER_LOST]
    assert rule.arm is Response.HOLD_UNTIL_TARGET
    recorders.truth_start(rig, FOLLOWER, 5.0)
    LOST[how](led)
    led.passes = False  # whoever calls for the leader's action gets an error instead
    led.run(rule.within_s)
    assert not led.states[-1].coupled and led.states[-1].mode is Mode.TRACK
    begun = led.states[-1]
    led.run(1.0)
    assert steps(rig) < BRAKING_RAD_S
    assert np.abs(led.states[-1].setpoint_q - begun.setpoint_q).max() < 0.025  # 0.94 rad/s, braked with 30 rad/s²
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
    assert steps(rig) < BRAKING_RAD_S
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
