"""Configuration of a base's linear rail. All values are plain: they travel as JSON."""

import math
from dataclasses import dataclass
from typing import Literal, get_args

from lerobot_robot_yam.arm.option import option, within
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.mobile.rail_profile import (
    CONVERTER_PINS,
    GPIO_PINS,
    HARD_CAP_M_S,
    HARD_CAP_M_S2,
    SOFT_END_M,
    STROKE_M,
)
from lerobot_robot_yam.system.paths import user_path

RailDriver = Literal["gpio", "usb_gpio", "sim"]


@dataclass(kw_only=True)
class RailConfig:
    """The rail of one base: motor 9 on the base's channel, a brake and two switches."""

    io: RailDriver = option(
        "what reads the switches and drives the brake: gpio (pins of a Raspberry Pi), usb_gpio (the vendor's USB "
        "converter), sim (the virtual rig)",
        "gpio",
    )
    port: str = option("serial port of the USB converter, such as /dev/ttyUSB0", "")
    pins: list[int] | None = option(
        f"upper switch, lower switch, brake: BCM numbers, by default {list(GPIO_PINS)}, or channels of the converter, "
        f"by default {list(CONVERTER_PINS)}",
        None,
    )
    direction: int = option("1: positive motor rates go up; -1: down", 1)
    stroke_m: float = option("travel between the switches, m", STROKE_M)
    velocity_limit: float = option(f"m/s, at most {HARD_CAP_M_S:g}", 0.5)
    acceleration_limit: float = option(f"m/s², at most {HARD_CAP_M_S2:g}", 0.5)
    full_speed_below_m: float = option("height, m, up to which the base may drive with full speed", 0.3)
    top_speed: float = option("share of the base's speed at the top, 0.05 to 1; below it the share grows evenly", 0.3)
    calibration_path: str | None = option(
        "JSON file that keeps travel and last height; by default none: the rail is homed after each start", None
    )

    def __post_init__(self) -> None:
        if self.io not in get_args(RailDriver):
            raise ConfigError(f"rail: io is one of {', '.join(get_args(RailDriver))}, not {self.io!r}")
        if (self.io == "usb_gpio") != bool(self.port):
            raise ConfigError("rail: give port, the serial port of the converter, with io usb_gpio and only with it")
        if self.direction not in (1, -1):
            raise ConfigError(f"rail: direction is 1 or -1, not {self.direction!r}")
        ranges = {
            "stroke_m": (4.0 * SOFT_END_M, 5.0),
            "velocity_limit": (0.001, HARD_CAP_M_S),
            "acceleration_limit": (0.01, HARD_CAP_M_S2),
            "full_speed_below_m": (0.0, 5.0),
            "top_speed": (0.05, 1.0),
        }
        for name, (low, high) in ranges.items():
            within(f"rail: {name}", getattr(self, name), low, high)
        pins = self.wiring
        if len(pins) != 3 or len(set(pins)) != 3 or not all(isinstance(pin, int) and 0 <= pin < 64 for pin in pins):
            raise ConfigError(
                f"rail: pins are three numbers, of upper switch, lower switch and brake, not {self.pins!r}"
            )

    @property
    def stored(self) -> bool:
        """Whether the file with travel and last height is there."""
        return self.calibration_path is not None and user_path(self.calibration_path).is_file()

    @property
    def wiring(self) -> tuple[int, ...]:
        """Pins or channels of upper switch, lower switch and brake."""
        if self.pins is not None:
            return tuple(self.pins)
        return CONVERTER_PINS if self.io == "usb_gpio" else GPIO_PINS

    def driving_share(self, height_m: float) -> float:
        """Return the share of its speed with which the base may drive at a height, m; NaN counts as the top."""
        span = max(self.stroke_m - self.full_speed_below_m, 1e-6)
        above = min(max((height_m - self.full_speed_below_m) / span, 0.0), 1.0) if math.isfinite(height_m) else 1.0
        return 1.0 - (1.0 - self.top_speed) * above
