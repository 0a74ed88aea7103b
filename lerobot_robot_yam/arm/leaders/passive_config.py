"""Options of a leader without motors: how its encoder angles are converted to the follower's joint angles.

All values are plain, since the dataclass is sent as JSON to the process that reads the encoders.
"""

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from lerobot_robot_yam.arm.option import real
from lerobot_robot_yam.errors import ConfigError

Kind = Literal["desk", "mobile_left", "mobile_right"]
# Direction of each encoder relative to the follower's joint. Source: the vendor's station software, August 2026.
JOINT_SIGNS: dict[str, list[int]] = {
    "desk": [-1, -1, 1, 1, -1, -1],
    "mobile_left": [-1, 1, 1, 1, -1, -1],
    "mobile_right": [-1, -1, -1, -1, -1, -1],
}
_LEAST_RANGE_RAD = 0.2  # minimum range of a joint, rad; less means that the joint was not moved


@dataclass(kw_only=True)
class PassiveConfig:
    """Options for reading the encoders of one leader.

    Attributes:
        joint_sign: (n,) 1 or -1.
        mapping: direct: the follower gets the leader's angles; range: the leader's range is scaled to the follower's.
        leader_range_rad: (n, 2) minimum and maximum angle of each leader joint; None: as calibrated.
        calibration_path: file with zeros and ranges; None: the encoders' own zeros are used.
        home_rad: (n,) pose of the leader during its zero calibration; None: all zero.
    """

    joint_sign: list[int]
    mapping: Literal["direct", "range"] = "direct"
    leader_range_rad: list[list[float]] | None = None
    calibration_path: str | None = None
    home_rad: list[float] | None = None

    def check(self, name: str, joints: int) -> None:
        """Check the values. Raises ConfigError: a value is invalid; the message names arm, option and valid values."""
        signs = self.joint_sign
        if not isinstance(signs, Sequence) or len(signs) != joints or any(sign not in (1, -1) for sign in signs):
            raise ConfigError(f"{name}: joint_sign takes 1 or -1 for each of {joints} joints; got {signs!r}")
        home = self.home_rad
        if home is not None and (not isinstance(home, Sequence) or len(home) != joints or not _finite(home)):
            raise ConfigError(f"{name}: home_rad takes an angle for each of {joints} joints, rad; got {home!r}")
        if self.mapping not in ("direct", "range"):
            raise ConfigError(f"{name}: mapping takes direct or range; got {self.mapping!r}")
        if self.leader_range_rad is not None:
            check_ranges(f"{name}: leader_range_rad", self.leader_range_rad, joints)
            if self.mapping == "direct":
                raise ConfigError(f"{name}: leader_range_rad is for mapping: range")


class PassiveOptions:
    """Options of a leader without motors: those fields of `ArmConfig` that apply without motors."""

    name: str

    @abstractmethod
    def passive_config(self) -> PassiveConfig:
        """Create the options for reading the leader's encoders."""


def _finite(values: Sequence[Any]) -> bool:
    return all(math.isfinite(real(value)) for value in values)


def check_ranges(what: str, ranges: Any, joints: int) -> None:
    """Check ranges (joints, 2). Raises ConfigError: a range is malformed; the message begins with `what`."""
    rows = ranges if isinstance(ranges, Sequence) and not isinstance(ranges, str) else []
    for row in rows:
        pair = row if isinstance(row, Sequence) and not isinstance(row, str) and len(row) == 2 else (math.nan, 0.0)
        if not _finite(pair) or pair[1] - pair[0] < _LEAST_RANGE_RAD:
            raise ConfigError(
                f"{what} takes [lowest, highest] rad for each joint, at least {_LEAST_RANGE_RAD:g} apart; got {row!r}"
            )
    if len(rows) != joints:
        raise ConfigError(f"{what} takes [lowest, highest] rad for each of {joints} joints; got {ranges!r}")
