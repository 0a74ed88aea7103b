"""LeRobot configs of a gamepad (`--teleop.type=yam_gamepad`) and of keys (`yam_base_keys`) that drive a mobile base."""

from collections.abc import Callable
from dataclasses import dataclass

from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_robot_yam.arm.option import option, real
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.driving.drive_options import DriveOptions
from lerobot_robot_yam.face.registration import register_as


@dataclass(kw_only=True)
class PadOptions:
    """Options of a teleoperator with a gamepad."""

    pad: str | None = option("GUID of the gamepad, or a part of its name; by default the only one", None)
    dead_zone: float = option("share of a stick's way in which the base stands still", 0.05)
    rail_dead_zone: float = option("the same, of the stick that moves the rail", 0.15)
    expo: float = option("0: speed is proportional to deflection; 1: to its cube, which is finer near rest", 0.3)

    def check_pad(self, device: str) -> None:
        """Check the values. Raises ConfigError: a value is out of range; the message names it."""
        for name, most in (("dead_zone", 0.5), ("rail_dead_zone", 0.5), ("expo", 1.0)):
            if not 0.0 <= real(getattr(self, name)) <= most:
                raise ConfigError(f"{device}: {name} is 0 to {most:g}, not {getattr(self, name)!r}")
        if self.pad == "":
            raise ConfigError(f"{device}: pad is empty; give a part of the gamepad's name, or leave it away")


def refuse_drive(*checks: Callable[[str], None], device: str) -> None:
    """Raise RefusedConfigError if a check of a device's options fails."""
    from lerobot_robot_yam.face.lerobot_command.config_refusal import RefusedConfigError  # late, for a quick start

    try:
        for check in checks:
            check(device)
    except ConfigError as error:
        raise RefusedConfigError(str(error)) from error


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
