"""Config of the scripted policy (`type: scripted`)."""

from dataclasses import dataclass, field

from lerobot.configs import NormalizationMode, PreTrainedConfig
from lerobot.optim import AdamWConfig

BEHAVIOURS = ("sines", "reach", "nothing", "nan", "short", "jumps", "slow", "replay")


@PreTrainedConfig.register_subclass("scripted")
@dataclass
class ScriptedConfig(PreTrainedConfig):
    """What the policy does, from the pose of its first observation on.

    Attributes:
        behaviour: "sines" moves every joint there and back for ever; "reach" goes there and stays; "nothing" stays
            where it is; "nan" does as "sines" and after
            `good_s` says NaN once in every action; "short" leaves out the last coordinate; "jumps" alternates between
            the start and `amplitude` beyond it, action by action; "slow" is "sines" that takes `delay_s` to answer;
            "replay" does in its n-th episode what was done in the n-th of a file, for each row of a batch.
        actions: of "replay", an .npz of (k, n) arrays "0", "1", …; empty: each episode stays where it begins.
        amplitude: largest distance from the start, in the unit of the observations.
        period_s: of the sines.
        fps, chunk_size: of `predict_action_chunk`.
        action_feature_names: as LeRobot's pi0 keeps them of its training data.
    """

    behaviour: str = "sines"
    actions: str = ""
    amplitude: float = 0.3
    period_s: float = 3.0
    fps: float = 30.0
    chunk_size: int = 50
    delay_s: float = 0.8
    good_s: float = 1.5
    action_feature_names: list[str] | None = None
    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: {"STATE": NormalizationMode.MEAN_STD, "ACTION": NormalizationMode.MEAN_STD}
    )

    def __post_init__(self):
        super().__post_init__()
        if self.behaviour not in BEHAVIOURS:
            raise ValueError(f"behaviour is one of {', '.join(BEHAVIOURS)}, not {self.behaviour!r}")

    def validate_features(self):
        pass

    def get_optimizer_preset(self):
        return AdamWConfig()

    def get_scheduler_preset(self):
        return None

    observation_delta_indices = None
    action_delta_indices = None
    reward_delta_indices = None
