"""Configuration of a base: its channel, limits and sizes. All values are plain: they travel as JSON."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from lerobot_robot_yam.arm.config import channel_options
from lerobot_robot_yam.arm.option import from_plain, option, real, within
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.mobile.base_limits import BaseLimits
from lerobot_robot_yam.mobile.base_profile import (
    COMMAND_TIMEOUT_S,
    HARD_CAP,
    HARD_CAP_ACCELERATION,
    BaseProfile,
)
from lerobot_robot_yam.mobile.rail_config import RailConfig

BASE = "base"  # word that names a base where commands take the profile of an arm
BASE_PREFIX = "base_"  # of the base among the parts of a robot, as left_ is of the left arm
_RATE_HZ = (100.0, 350.0)  # the stand-by would treat a slower loop as dead; the wire carries no faster one


@dataclass(kw_only=True)
class BaseConfig:
    """One base on one CAN channel."""

    channel: str = option("CAN channel by python-can's name, such as can_base or, on the virtual rig, base")
    name: str = option("what messages call this base", "base")
    interface: str = option("python-can interface: socketcan, or yam_sim (the virtual rig)", "socketcan")
    can_options: dict[str, Any] = option("further keyword arguments of can.Bus", factory=dict)
    velocity_limit: list[float] = option(
        f"of x, y, theta, m/s, m/s, rad/s; at most {HARD_CAP[0]:g}, {HARD_CAP[1]:g}, {HARD_CAP[2]:.2f}",
        factory=lambda: [0.5, 0.5, 1.57],
    )
    acceleration_limit: list[float] = option(
        f"of x, y, theta, m/s², m/s², rad/s²; at most {HARD_CAP_ACCELERATION[0]:g}, {HARD_CAP_ACCELERATION[1]:g}, "
        f"{HARD_CAP_ACCELERATION[2]:g}",
        factory=lambda: [0.25, 0.25, 0.79],
    )
    jerk_limit: list[float] | None = option("of x, y, theta, m/s³, m/s³, rad/s³; by default no limit", None)
    wheel_radius_m: float = option("radius of the wheels, m", BaseProfile().radius_m)
    track_factor: float = option("factor on the casters' distances from the centre, from a measured turn", 1.0)
    command_timeout_s: float = option("when the newest target is older, s, the base brakes", COMMAND_TIMEOUT_S)
    max_state_age_s: float = option("a state that is older, s, is an error, never an answer", 0.25)
    rail: RailConfig | None = option("the linear rail; by default there is none", None)
    rate_hz: float = option("of the control loop, Hz, 100 to 350; that of the arms of the same robot", 250.0)
    skip_listen: bool = option("true: do not listen for another driver on the channel first", False)

    def __post_init__(self) -> None:
        if isinstance(self.rail, Mapping):  # from JSON
            self.rail = from_plain(RailConfig, self.rail, f"{self.name}: rail")
        if not self.channel:
            raise ConfigError(f"{self.name}: channel is empty; name the base's CAN channel, such as can_base")
        within(f"{self.name}: rate_hz", self.rate_hz, *_RATE_HZ)
        within(f"{self.name}: command_timeout_s", self.command_timeout_s, 0.02, 2.0)
        within(f"{self.name}: max_state_age_s", self.max_state_age_s, 0.02, 2.0)
        within(f"{self.name}: track_factor", self.track_factor, 0.5, 2.0)
        self.limits()
        self.profile()

    def checked(self) -> "BaseConfig":
        """Return the base's own options out of those of a subclass, checked. Raises ConfigError."""
        return BaseConfig(**{field.name: getattr(self, field.name) for field in fields(BaseConfig)})

    @property
    def on_command_line(self) -> str:
        """Command line options with which `yam-motors` and `yam-zero` find the base."""
        return f"{channel_options(self)} --arm {BASE}"

    def limits(self) -> BaseLimits:
        """Return the limits. Raises ConfigError: a limit is not above 0, or above its cap."""
        jerk = None if self.jerk_limit is None else tuple(map(real, self.jerk_limit))
        return BaseLimits(tuple(map(real, self.velocity_limit)), tuple(map(real, self.acceleration_limit)), jerk)

    def profile(self) -> BaseProfile:
        """Return the vendor's base with this one's measured size. Raises ConfigError: a size is out of range."""
        return BaseProfile().resized(real(self.wheel_radius_m), real(self.track_factor))


def with_rail_file(config: BaseConfig, directory: Path, ident: str | None) -> BaseConfig:
    """Return a base's config whose rail keeps its height in a file; by default in LeRobot's calibration directory.

    ident: LeRobot's id of the robot.
    """
    if config.rail is None or config.rail.calibration_path is not None:
        return config
    path = directory / "yam" / f"{ident or config.channel}_rail.json"  # a subdirectory, whose files LeRobot never reads
    return replace(config, rail=replace(config.rail, calibration_path=str(path)))
