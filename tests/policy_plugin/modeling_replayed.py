"""The replayed policy: counts its episodes, one for each environment of a batch."""

import numpy as np
import torch
from lerobot.policies.pretrained import PreTrainedPolicy
from torch import nn

from tests.policy_plugin.configuration_replayed import ReplayedConfig


class ReplayedPolicy(PreTrainedPolicy):
    """The first observation of an episode is where it stays when there is nothing to replay."""

    config_class = ReplayedConfig
    name = "replayed"

    def __init__(self, config, **kwargs):
        super().__init__(config)
        self.unused = nn.Parameter(torch.zeros(1))  # a checkpoint without weights is none
        self._episodes = None
        if config.actions:
            with np.load(config.actions) as file:
                self._episodes = [torch.from_numpy(file[str(index)]) for index in range(len(file.files))]
        self._batch, self._tick, self._stay = -1, 0, None

    def reset(self):
        self._batch, self._tick, self._stay = self._batch + 1, 0, None

    def get_optim_params(self):
        return self.parameters()

    def forward(self, batch):
        return (self.unused**2).sum(), None

    def predict_action_chunk(self, batch, **kwargs):
        return self.select_action(batch)[:, None]

    def select_action(self, batch, **kwargs):
        state = batch["observation.state"]
        self._stay = state.clone() if self._stay is None else self._stay
        tick, self._tick = self._tick, self._tick + 1
        if self._episodes is None:
            return self._stay
        first = self._batch * len(state)
        episodes = [self._episodes[first + index] for index in range(len(state))]
        return torch.stack([episode[min(tick, len(episode) - 1)] for episode in episodes])
