"""The scripted policy: a clock, and the pose that it has seen first."""

import math
import time

import numpy as np
import torch
from lerobot.policies.pretrained import PreTrainedPolicy
from torch import nn

from tests.policy_plugin.configuration_scripted import ScriptedConfig

GRIPPER = 6  # every seventh coordinate: half a stroke of movement, in whatever unit the joints are
HALF_STROKE = 0.5


class ScriptedPolicy(PreTrainedPolicy):
    """Answers by the time of the wall, so that actions of different chunks fit together."""

    config_class = ScriptedConfig
    name = "scripted"

    def __init__(self, config, **kwargs):
        super().__init__(config)
        self.unused = nn.Parameter(torch.zeros(1))  # a checkpoint without weights is none
        self._start = self._since_s = None
        self._calls = 0
        self._batch, self._tick, self._stay = -1, 0, None  # of "replay"
        self._episodes = None
        if config.actions:
            with np.load(config.actions) as file:
                self._episodes = [torch.from_numpy(file[str(index)]) for index in range(len(file.files))]

    def reset(self):
        """Keeps the start pose: after a human's correction it wants back to where it was, wherever that is."""
        self._batch, self._tick, self._stay = self._batch + 1, 0, None

    def supports_rtc(self):
        return True

    def get_optim_params(self):
        return self.parameters()

    def forward(self, batch):
        return (self.unused**2).sum(), None

    def select_action(self, batch, **kwargs):
        if self.config.behaviour == "replay":
            return self._replayed(batch["observation.state"])
        return self._actions(batch, 1)[:, 0]

    def _replayed(self, state):
        """(B, n): the next actions, for the states (B, n)."""
        self._stay = state.clone() if self._stay is None else self._stay
        tick, self._tick = self._tick, self._tick + 1
        if self._episodes is None:
            return self._stay
        episodes = self._episodes[self._batch * len(state) :][: len(state)]
        return torch.stack([episode[min(tick, len(episode) - 1)] for episode in episodes])

    def predict_action_chunk(self, batch, inference_delay=0, prev_chunk_left_over=None, **kwargs):
        return self._actions(batch, self.config.chunk_size)

    def _actions(self, batch, count):
        """(1, count, n): the actions of `count` ticks from now on."""
        config, state = self.config, batch["observation.state"]
        if self._start is None:
            self._start, self._since_s = state[0].clone(), time.monotonic()
        now_s = time.monotonic() - self._since_s
        if config.behaviour == "slow":
            time.sleep(config.delay_s)
        n = len(self._start)
        reach = torch.full((n,), config.amplitude)
        reach[GRIPPER :: GRIPPER + 1] = HALF_STROKE
        reach = torch.where((reach == HALF_STROKE) & (self._start > HALF_STROKE), -reach, reach)
        rows = []
        for index in range(count):
            share = self._share(now_s + index / config.fps)
            row = self._start + reach * share
            if config.behaviour == "nan" and now_s > config.good_s:
                row[1] = math.nan
            rows.append(row)
        actions = torch.stack(rows)[None]
        return actions[:, :, :-1] if config.behaviour == "short" else actions

    def _share(self, t_s):
        """Of the amplitude, at a time."""
        if self.config.behaviour == "nothing":
            return 0.0
        if self.config.behaviour == "jumps":
            self._calls += 1
            return self._calls % 2
        if self.config.behaviour == "reach":
            t_s = min(t_s, self.config.period_s / 2.0)
        return (1.0 - math.cos(2.0 * math.pi * t_s / self.config.period_s)) / 2.0  # begins at rest
