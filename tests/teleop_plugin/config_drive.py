"""Config of a teleoperator that drives a base."""

from dataclasses import dataclass

from lerobot.teleoperators.config import TeleoperatorConfig


@TeleoperatorConfig.register_subclass("drive")
@dataclass
class DriveConfig(TeleoperatorConfig):
    """speed: m/s, forwards; turn: degrees/s. It drives for drive_s, s, then it stands."""

    speed: float = 0.3
    turn: float = 20.0
    drive_s: float = 3.0
