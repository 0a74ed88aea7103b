"""LeRobot configs of a gamepad (`--teleop.type=yam_gamepad`) and of keys (`yam_base_keys`) that drive a mobile base."""

from dataclasses import dataclass

from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_robot_yam.arm.option import option, real
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.driving.drive_options import DriveOptions, PadOptions, refuse_drive
from lerobot_robot_yam.face.registration import register_as


@register_as(TeleoperatorConfig, "yam_gamepad")
@dataclass(kw_only=True)
class YamGamepadConfig(TeleoperatorConfig, DriveOptions, PadOptions):
    """Options of one gamepad that drives a base."""

    def __post_init__(self) -> None:
        refuse_drive(self.check_drive, self.check_pad, device="yam_gamepad")


@register_as(TeleoperatorConfig, "yam_base_keys")
@dataclass(kw_only=True)
class YamBaseKeysConfig(TeleoperatorConfig, DriveOptions):
    """Options of keys that drive a base."""

    hold_s: float = option(
        "a key counts as held for this time after each repeat of the terminal, s, 0.1 to 0.7; longer than the time "
        "between two repeats",
        0.2,
    )

    def __post_init__(self) -> None:
        refuse_drive(self.check_drive, self.check_keys, device="yam_base_keys")

    def check_keys(self, device: str) -> None:
        """Check the values. Raises ConfigError: a value is out of range; the message names it."""
        if not 0.1 <= real(self.hold_s) <= 0.7:
            raise ConfigError(f"{device}: hold_s is 0.1 to 0.7 s, not {self.hold_s!r}")
