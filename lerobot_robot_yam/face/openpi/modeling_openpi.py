"""LeRobot policy without weights, which requests action chunks from an openpi server and returns single actions."""

import weakref
from collections import deque
from pathlib import Path
from typing import Any, Self

import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.policies.rtc import RTCProcessor
from lerobot.utils.constants import OBS_STATE

from lerobot_robot_yam.errors import ActionError, ConfigError, PolicyServerError
from lerobot_robot_yam.face.openpi.configuration_openpi import YamOpenpiConfig
from lerobot_robot_yam.face.openpi.messages import (
    STATEFUL_KEY,
    action_chunk,
    check_metadata,
    check_state,
    server_observation,
)
from lerobot_robot_yam.face.openpi.server_connection import ServerConnection


class YamOpenpiPolicy(PreTrainedPolicy):
    """Policy whose actions come from a server.

    The constructor connects, so that a wrong address or a server for another robot is refused before an arm is
    energised. Any later failure raises an error instead of returning an action, so the arms hold.

    Raises:
        ConfigError: a field of the config is invalid, or contradicts the server's metadata.
        PolicyServerError: the server cannot be reached.
    """

    config_class = YamOpenpiConfig
    name = "yam_openpi"

    def __init__(self, config: YamOpenpiConfig, **_: Any):
        super().__init__(config)
        config.validate_features()
        self._server = ServerConnection(config, lambda metadata: check_metadata(config, metadata))
        self._server.open()
        self._hang_up = weakref.finalize(self, self._server.close)  # also called when the interpreter ends
        self._queue: deque[torch.Tensor] = deque()
        self._rtc: RTCProcessor | None = None
        self._episode, self._asked = 0, False
        self._begun = 0  # number of the episode that the server has begun
        # whether the next observation is old: after a reset, real-time chunking sends one old observation
        self._outdated = False

    @classmethod
    def from_pretrained(
        cls, pretrained_name_or_path: str | Path | None, *, config: PreTrainedConfig | None = None, **options: Any
    ) -> Self:
        """Create the policy of this config, or of the config in the given directory. There are no weights to load."""
        if config is None:
            config = PreTrainedConfig.from_pretrained(pretrained_name_or_path, **options)
        return cls(config).eval()

    def _save_pretrained(self, save_directory: Path, *_: Any, **__: Any) -> None:
        """Save only the config. LeRobot 0.6.2 would save nothing for a policy without weights."""
        self.config._save_pretrained(save_directory)

    def close(self) -> None:
        """Disconnect. Idempotent."""
        self._hang_up()

    def reset(self) -> None:
        """Discard the rest of the chunk; the next action comes from a new chunk."""
        self._queue.clear()
        self._outdated = self._rtc is not None and self._asked
        self._episode += 1

    def select_action(self, batch: dict[str, Any], **_: Any) -> torch.Tensor:
        """Return the next action, (B, n), from a new chunk when the last one is used up.

        Raises:
            YamError: see `predict_action_chunk`.
        """
        if not self._queue:
            chunk = self.predict_action_chunk(batch)
            self._queue.extend(chunk[:, : self.config.n_action_steps].unbind(dim=1))
        return self._queue.popleft()

    def predict_action_chunk(
        self,
        batch: dict[str, Any],
        inference_delay: int = 0,
        prev_chunk_left_over: torch.Tensor | None = None,
        **_: Any,
    ) -> torch.Tensor:
        """Request a new chunk of actions, (B, steps, n).

        Args:
            batch: see `server_observation`. Each row is a separate request.
            inference_delay: number of steps of the running chunk that are executed before the new chunk can begin.
            prev_chunk_left_over: remaining actions of the running chunk, (k, n), padded with zeros.

        Raises:
            PolicyServerError: the server failed, disconnected, or timed out; with real-time chunking also if request or
                reply belong to the previous episode, after which LeRobot sends a new request.
            ActionError: the actions are not valid.
            ConfigError: the robot lacks an observation that the server expects.
        """
        if OBS_STATE not in batch:
            raise ConfigError(f"there is no {OBS_STATE} to send; the robot has to observe its positions")
        if self._outdated:
            self._outdated = False
            raise PolicyServerError("a new episode has begun; its first observation is waited for")
        self._asked, episode = True, self._episode
        if self._begun != episode:
            self._server.reset()
            self._begun = episode
        count = len(batch[OBS_STATE])
        if count > 1 and self._server.metadata.get(STATEFUL_KEY):
            raise ConfigError(
                f"the {self.config.server} remembers what it has seen, and cannot tell {count} environments apart; "
                "set --eval.batch_size=1"
            )
        rows = [self._ask(batch, row) for row in range(count)]
        if self._rtc is not None and episode != self._episode:
            raise PolicyServerError(f"the {self.config.server} has answered for an episode that is over")
        if len({len(row) for row in rows}) > 1:
            raise ActionError(f"the {self.config.server} plans unlike numbers of steps: {[len(row) for row in rows]}")
        chunk = torch.stack(rows)
        if self._rtc is not None and self._rtc.rtc_config.enabled and prev_chunk_left_over is not None:
            chunk = self._cross_fade(chunk, inference_delay, prev_chunk_left_over)
        return chunk

    def _ask(self, batch: dict[str, Any], row: int) -> torch.Tensor:
        observation = server_observation(self.config, batch, row)
        state = observation[self.config.state_key]
        feature = self.config.action_feature
        width = self.config.action_dim or (feature.shape[0] if feature is not None else len(state))
        check_state(self.config, state[:width])
        return torch.from_numpy(action_chunk(self.config, self._server.infer(observation), width))

    def supports_rtc(self) -> bool:
        """Return True: `--inference.type=rtc` requests the next chunk while the current one runs."""
        return True

    def init_rtc_processor(self) -> None:
        """Create the processor of real-time chunking. lerobot-rollout calls this once `rtc_config` is in the config."""
        self._rtc = RTCProcessor(self.config.rtc_config)

    def _cross_fade(self, chunk: torch.Tensor, delay: int, running: torch.Tensor) -> torch.Tensor:
        """Return the chunk, blended with the remaining part of the running chunk.

        openpi's protocol has no field for the running chunk, so that chunk cannot guide the server as in proper
        real-time chunking. Instead the actions are blended with that method's weights
        (`RTCConfig.prefix_attention_schedule`).
        """
        assert self._rtc is not None
        steps = running.any(dim=1).nonzero()  # excludes the padding, and steps of zeros directly before the padding
        length = min(int(steps.max()) + 1 if len(steps) else 0, chunk.shape[1])
        weights = self._rtc.get_prefix_weights(delay, length, chunk.shape[1])[:length, None]
        mixed = chunk.clone()
        mixed[:, :length] += weights * (running[:length] - chunk[:, :length])
        return mixed

    def forward(self, batch: dict[str, Any]) -> tuple[torch.Tensor, dict | None]:
        raise ConfigError("a yam_openpi policy cannot be trained here; its server's policy is trained by openpi")

    def get_optim_params(self) -> dict:
        raise ConfigError("a yam_openpi policy has no parameters to train")
