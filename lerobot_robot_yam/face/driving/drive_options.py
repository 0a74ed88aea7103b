"""Options of teleoperators that drive a mobile base. Does not import what drives: LeRobot loads this at its start."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from lerobot_robot_yam.arm.option import option, real
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.mobile.base_profile import HARD_CAP

_RAIL_CAP = 1.0  # maximum of `rail_speed`, m/s


@dataclass(kw_only=True)
class DriveOptions:
    """Options of a teleoperator that drives a base."""

    rail: bool = option("the base has a rail, and the action height.vel", False)
    speed: list[float] = option(
        "at full deflection, of x, y, theta, m/s, m/s, deg/s; a base in the same process lowers it to its own limits",
        factory=lambda: [0.5, 0.5, 90.0],
    )
    rail_speed: float = option("of the rail at full deflection, m/s", 0.5)
    slow_factor: float = option("on both speeds while driving slowly, 0 to 1", 0.3)

    def drive_keys(self) -> tuple[str, ...]:
        """Return the keys of the base's part of an action."""
        from lerobot_robot_yam.face.devices.base_part import action_keys  # late import, for a quick start

        return tuple(action_keys("vel" if self.rail else None))

    def check_drive(self, device: str) -> None:
        """Check the values. Raises ConfigError: a value is out of range; the message names it."""
        caps = (HARD_CAP[0], HARD_CAP[1], math.degrees(HARD_CAP[2]))
        speeds = list(map(real, self.speed)) if isinstance(self.speed, Sequence) else []
        if len(speeds) != 3 or not all(0.0 < speed <= cap for speed, cap in zip(speeds, caps, strict=True)):
            raise ConfigError(
                f"{device}: speed is three numbers above 0, at most {caps[0]:g}, {caps[1]:g} m/s and {caps[2]:g} "
                f"deg/s, not {self.speed!r}"
            )
        if not 0.0 < real(self.rail_speed) <= _RAIL_CAP:
            raise ConfigError(f"{device}: rail_speed is above 0, at most {_RAIL_CAP:g} m/s, not {self.rail_speed!r}")
        if not 0.0 < real(self.slow_factor) <= 1.0:
            raise ConfigError(f"{device}: slow_factor is above 0, at most 1, not {self.slow_factor!r}")


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
