"""Mapping from a passive leader's encoders to the follower's joints, and the calibration file with zeros and ranges.

a = sign · encoder − zero                                    the leader's own angle
q = a                                                        direct
q = low + (a − a_low) / (a_high − a_low) · (high − low)      range: a leader of another size
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_robot_yam.arm.leaders.passive_config import PassiveConfig, check_ranges
from lerobot_robot_yam.damiao.passive_encoders import TRIGGER_TRAVEL_RAD
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.paths import user_path, write_whole

_FILE_VERSION = 1
_LEAST_TRAVEL_RAD = 0.1


@dataclass(frozen=True)
class PassiveCalibration:
    """Calibration of one leader: zeros (n,) rad, ranges (n, 2) rad, and angle of the squeezed trigger, rad."""

    zero_rad: list[float]
    range_rad: list[list[float]]
    trigger_rad: float

    @classmethod
    def load(cls, arm: str, path: Path, joints: int) -> "PassiveCalibration | None":
        """Load the stored calibration; return None if there is no file.

        Raises:
            ConfigError: the file is unreadable, invalid, or for a different number of joints.
        """
        try:
            data: dict[str, Any] = json.loads(path.read_text())
            found = cls([float(zero) for zero in data["zero_rad"]], data["range_rad"], float(data["trigger_rad"]))
            if data["version"] != _FILE_VERSION or len(found.zero_rad) != joints:
                raise ValueError(f"it is of version {data['version']}, for {len(found.zero_rad)} joints")
            check_ranges("range_rad", found.range_rad, joints)
            if not all(map(math.isfinite, (*found.zero_rad, found.trigger_rad))):
                raise ValueError("its numbers are not finite")
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError, ConfigError) as error:
            raise ConfigError(
                f"{arm}: {path} is no calibration of a passive leader with {joints} joints ({error}); delete it and "
                "calibrate again (lerobot-calibrate)"
            ) from error
        return found

    def check(self, arm: str) -> None:
        """Check the calibrated motion. Raises ConfigError: a joint was not moved, or the trigger was not squeezed."""
        check_ranges(f"{arm}: a calibration", self.range_rad, len(self.zero_rad))
        if self.trigger_rad < _LEAST_TRAVEL_RAD:
            raise ConfigError(f"{arm}: the trigger was not squeezed; calibrate again")

    def save(self, arm: str, path: Path) -> None:
        """Write the calibration file. Raises ConfigError: the file cannot be written."""
        data = {"version": _FILE_VERSION, "zero_rad": self.zero_rad, "range_rad": self.range_rad}
        try:
            write_whole(path, json.dumps(data | {"trigger_rad": self.trigger_rad}, indent=1) + "\n")
        except OSError as error:
            raise ConfigError(f"{arm}: the calibration cannot be stored in {path} ({error})") from error


class PassiveMapping:
    """Encoder mapping for one leader with n joints.

    Args:
        arm: the leader's name, for messages.
        config: the passive leader's configuration.
        limits_rad: (n, 2) joint limits of the follower.

    Raises:
        ConfigError: the calibration is unusable, or ranges for the range mapping are missing.
    """

    def __init__(self, arm: str, config: PassiveConfig, limits_rad: np.ndarray):
        joints = len(limits_rad)
        path = config.calibration_path
        found = None if path is None else PassiveCalibration.load(arm, user_path(path), joints)
        self._sign = np.array(config.joint_sign, dtype=float)
        self._zero = np.zeros(joints) if found is None else np.array(found.zero_rad)
        squeezed = TRIGGER_TRAVEL_RAD if found is None else abs(found.trigger_rad)
        self._travel = min(max(squeezed, _LEAST_TRAVEL_RAD), TRIGGER_TRAVEL_RAD)
        self._scale, self._shift = np.ones(joints), np.zeros(joints)
        if config.mapping == "range":
            ranges = config.leader_range_rad or (None if found is None else found.range_rad)
            if ranges is None:
                raise ConfigError(
                    f"{arm}: mapping: range needs the leader's ranges; calibrate it (lerobot-calibrate), or give "
                    "leader_range_rad"
                )
            low, high = np.array(ranges, dtype=float).T
            self._scale = (limits_rad[:, 1] - limits_rad[:, 0]) / (high - low)
            self._shift = limits_rad[:, 0] - self._scale * low

    def joints(self, encoder_rad: np.ndarray, rate_rad_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute the follower's joint positions and speeds, (n,) each, from the leader's encoders, (n,) each."""
        q = self._scale * (self._sign * encoder_rad - self._zero) + self._shift
        return q, self._scale * self._sign * rate_rad_s

    def trigger(self, encoder_rad: float) -> float:
        """Compute the trigger's position, 0 released … 1 squeezed, for either direction of its encoder."""
        return min(abs(encoder_rad), self._travel) / self._travel
