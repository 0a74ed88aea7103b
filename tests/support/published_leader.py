"""A follower in lock-step beside a leader of which there is nothing but its published state, as of another process."""

import os

import numpy as np

from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import STATE_DTYPE, channel_key, state_path
from lerobot_robot_yam.system.shared_block import SharedBlock
from tests.support.coupled import FOLLOWER, LEADER, POSE, arm_config

TICK_S, FRAME_S = 0.004, 1 / 30


class LedFollower:
    """A session of the follower, under way at its leader, which swings all joints about POSE. Then `run`.

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
                self.follower.write_target(self.target()[0], 0.5, coupled=(self._key, 0.1 + FRAME_S))
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
