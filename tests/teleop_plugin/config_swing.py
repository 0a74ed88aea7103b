"""Config of a teleoperator that swings one joint."""

from dataclasses import dataclass

from lerobot.teleoperators.config import TeleoperatorConfig


@TeleoperatorConfig.register_subclass("swing")
@dataclass
class SwingConfig(TeleoperatorConfig):
    """swing_rad: of joint 1, to either side."""

    swing_rad: float = 0.3
