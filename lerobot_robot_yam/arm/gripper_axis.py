"""The gripper's part of an arm: search for its stops, normalised coordinate, force-limited command."""

from pathlib import Path

import numpy as np

from lerobot_robot_yam.arm import laws
from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.force_limiter import ForceLimiter
from lerobot_robot_yam.arm.gripper import GripperStops, Search, find_stops, load_stops, save_stops, verify_stops
from lerobot_robot_yam.arm.profile import GripperProfile
from lerobot_robot_yam.errors import GripperError


class GripperAxis:
    """One gripper motor, joint-space motor angles in, MIT command out.

    Args:
        config, profile: the arm's configuration and its gripper.
        kp, kd: gains with which the motor is driven, Nm/rad and Nm s/rad.
    """

    def __init__(self, config: ArmConfig, profile: GripperProfile, kp: float, kd: float):
        assert profile.motor is not None and profile.calibration is not None
        self._name = config.name
        self._profile, self._calibration = profile, profile.calibration
        self._kp, self._kd = kp, kd
        self._force_limit_n = config.gripper_force_limit_n
        self._path = None if config.calibration_path is None else Path(config.calibration_path)
        self._configured = None if config.gripper_stops_rad is None else GripperStops(*config.gripper_stops_rad)
        self.stops: GripperStops | None = None
        self._search: Search | None = None
        self._push = (0.0, kd)
        self._limiter: ForceLimiter | None = None

    @property
    def searching(self) -> bool:
        """True while the stops are being found or verified."""
        return self._search is not None

    @property
    def force_limited(self) -> bool:
        """True while the limiter holds the squeeze back."""
        return self._limiter is not None and self._limiter.clogged

    def begin(self, calibrate: bool = False) -> None:
        """Start to verify the known stops, or to find them when there are none or `calibrate` says so.

        Raises:
            GripperError: the stored stops are damaged or impossible.
        """
        known = self._configured
        if known is None and self._path is not None:
            known = load_stops(self._path, self._profile.name)
        if known is None or calibrate:
            self._search = find_stops(self._name, self._calibration)
        else:
            self._search = verify_stops(self._name, self._calibration, known)
        self.stops = self._limiter = None
        self._push = next(self._search)

    def advance(self, now: float, motor_rad: float) -> float | None:
        """One tick of the search. Returns the shift of the reading, rad, once the stops are known.

        Raises:
            GripperError: the search failed.
        """
        assert self._search is not None
        try:
            self._push = self._search.send((now, motor_rad))
        except StopIteration as found:
            self._search = None
            self.stops = stops = GripperStops(found.value.closed_rad, found.value.open_rad)
            if self._path is not None:
                save_stops(self._path, self._profile.name, stops)
            if self._force_limit_n is not None and self._profile.limiter is not None:
                ends = (stops.closed_rad, stops.open_rad)
                self._limiter = ForceLimiter(self._profile.limiter, self._kp, ends, self._force_limit_n)
            return float(found.value.shift_rad)
        except GripperError:
            self._search = None
            raise
        return None

    def stop_search(self) -> None:
        """Give the search up, keep still."""
        self._search = None
        self._push = (0.0, self._kd)

    def normalised(self, motor_rad: float, motor_rate: float) -> tuple[float, float]:
        """Position 0 closed … 1 open and rate 1/s; zeros until the stops are known."""
        if self.stops is None:
            return 0.0, 0.0
        return self.stops.normalised(motor_rad), motor_rate / self.stops.span_rad

    def command(
        self, row: np.ndarray, now: float, u: float, u_rate: float, motor_rad: float, rate: float, tau: float
    ) -> None:
        """Fill the gripper's command row for set-point `u` moving at `u_rate`; `rate` and `tau` are measured."""
        if self.stops is None:
            speed, kd = self._push
            row[:] = motor_rad, speed, 0.0, kd, 0.0
            return
        target = self.stops.motor(u)
        row[laws.DQ] = u_rate * self.stops.span_rad
        if self._limiter is not None:
            limited = self._limiter.limit(now, target, motor_rad, rate, tau)
            low, high = sorted((self.stops.closed_rad, self.stops.open_rad))
            target = min(max(limited, low), high)
            self._limiter.sent(target)
            if self._limiter.clogged:
                row[laws.DQ] = 0.0
        row[laws.Q] = target
