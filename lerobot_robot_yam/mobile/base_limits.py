"""Limits of a base's velocity, acceleration and jerk. LeRobot loads this module at its start: no slow imports."""

import math
from dataclasses import dataclass

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.mobile.base_profile import HARD_CAP, HARD_CAP_ACCELERATION

_AXES = ("x", "y", "theta")


@dataclass(frozen=True)
class BaseLimits:
    """Limits per axis: x and y in m, heading in rad.

    Attributes:
        velocity: (3,) m/s, m/s, rad/s, at most `base_profile.HARD_CAP`.
        acceleration: (3,) m/s², m/s², rad/s².
        jerk: (3,) m/s³, m/s³, rad/s³; None: unlimited.
    """

    velocity: tuple[float, ...] = (0.5, 0.5, 1.57)
    acceleration: tuple[float, ...] = (0.25, 0.25, 0.79)
    jerk: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        caps = {"velocity": HARD_CAP, "acceleration": HARD_CAP_ACCELERATION, "jerk": (math.inf,) * 3}
        for name, cap in caps.items():
            values = getattr(self, name)
            if values is None:
                continue
            if len(values) != len(_AXES) or not all(0.0 < v <= most for v, most in zip(values, cap, strict=True)):
                raise ConfigError(f"base: {name} limits are above 0 and at most {cap} for x, y, theta, not {values}")
