"""Config of the replayed policy (`type: replayed`)."""

from dataclasses import dataclass, field

from lerobot.configs import NormalizationMode, PreTrainedConfig
from lerobot.optim import AdamWConfig


@PreTrainedConfig.register_subclass("replayed")
@dataclass
class ReplayedConfig(PreTrainedConfig):
    """Does in its n-th episode what was done in the n-th of a file.

    Attributes:
        actions: an .npz of (k, n) arrays "0", "1", …; empty: it stays where it is.
    """

    actions: str = ""
    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: {"STATE": NormalizationMode.IDENTITY, "ACTION": NormalizationMode.IDENTITY}
    )

    def validate_features(self):
        pass

    def get_optimizer_preset(self):
        return AdamWConfig()

    def get_scheduler_preset(self):
        return None

    observation_delta_indices = None
    action_delta_indices = None
    reward_delta_indices = None
