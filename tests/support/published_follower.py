"""A leader's `Lead` beside a follower of which there is nothing but its published state: ticks take no time."""

import os

import numpy as np

from lerobot_robot_yam.arm.leaders.lead_config import LeadConfig
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.teleop.lead import make_leads
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import STATE_DTYPE, channel_key, coupling_number, state_path
from lerobot_robot_yam.system.shared_block import SharedBlock
from tests.support.coupled import arm_config

TICK_S = 0.004


class LedPairs:
    """Leaders that float, each at `q`, and their followers' states. Set the attributes, then `run`.

    Attributes:
        leads: of each leader.
        q: of each leader (6,).
        modes: of each leader.
        handles: of each, trigger and buttons.
        setpoints: of each follower (7,).
        behind: of each follower (7,), from its set-point to where it is.
        follower_modes, coupled: of each follower; a coupled one takes its target at once.
        publishes: of each follower, whether its loop publishes its state.
    """

    def __init__(self, sides=("left",), **lead):
        self.name = f"pairs_{os.getpid()}"  # as a rig's
        self._keys = [channel_key("yam_lockstep", f"leader_{side}", self.name) for side in sides]
        configs = [
            arm_config(self, f"leader_{side}", LeadConfig(follower=f"follower_{side}", **lead)) for side in sides
        ]
        self.leads = make_leads([ResolvedArm(config) for config in configs])
        paths = [state_path(channel_key("yam_lockstep", f"follower_{side}", self.name)) for side in sides]
        self._blocks = [SharedBlock(path, STATE_DTYPE, create=True) for path in paths]
        self.q = [np.zeros(6) for _ in sides]
        self.modes = [Mode.FLOAT for _ in sides]
        self.handles = [(0.0, (False, False)) for _ in sides]
        self.setpoints = [np.zeros(7) for _ in sides]
        self.behind = [np.zeros(7) for _ in sides]
        self.follower_modes = [Mode.TRACK for _ in sides]
        self.coupled = [True for _ in sides]
        self.publishes = [True for _ in sides]
        self.now = 1.0

    def run(self, seconds=TICK_S):
        for _ in range(round(seconds / TICK_S)):
            self.now += TICK_S
            for index, lead in enumerate(self.leads):
                if self.coupled[index] and lead.action is not None:
                    self.setpoints[index] = lead.action.copy()
                if self.publishes[index]:
                    self._publish(index)
                sample = self.q[index], np.zeros(6), np.full(6, self.now)
                handle = *self.handles[index], self.now
                lead.advance(self.now, self.modes[index], sample, handle, np.zeros(6))

    def _publish(self, index):
        record = np.zeros((), STATE_DTYPE)
        record["owner_pid"] = os.getpid()
        record["stamp_s"] = record["motor_stamp_s"] = self.now
        record["mode"], record["joints"], record["motors"] = self.follower_modes[index], 6, 7
        record["setpoint"][:7] = self.setpoints[index]
        record["q"][:7] = self.setpoints[index] + self.behind[index]
        record["coupled_to"] = coupling_number(self._keys[index]) if self.coupled[index] else 0
        self._blocks[index].write(record)

    def remove_follower(self, index):
        """Its block goes, as when its process has ended."""
        self.publishes[index] = False
        self._blocks[index].close()

    def close(self):
        for lead, block in zip(self.leads, self._blocks, strict=True):
            lead.close()
            block.close()
