"""Gripper axis of an arm: search for the stops, normalised coordinate, force-limited command."""

import logging
import threading
from pathlib import Path

import numpy as np

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.profile import GripperProfile
from lerobot_robot_yam.control.gripper.force_limiter import ForceLimiter, GripForce
from lerobot_robot_yam.control.gripper.gripper_stops import (
    GripperStops,
    Search,
    find_stops,
    load_stops,
    save_stops,
    verify_stops,
)
from lerobot_robot_yam.control.laws import mit_laws
from lerobot_robot_yam.errors import GripperError

logger = logging.getLogger(__name__)


class Gripper:
    """Axis of a gripper motor: computes MIT commands from joint-space motor angles.

    Args:
        config, profile: the arm's configuration, and the gripper's profile.
        kp, kd: the motor's gains, Nm/rad and Nm s/rad.
    """

    def __init__(self, config: ArmConfig, profile: GripperProfile, kp: float, kd: float):
        assert profile.motor is not None and profile.calibration is not None
        self._torque_limit_nm = profile.motor.torque_limit_nm
        self._name = config.name
        self._profile, self._calibration = profile, profile.calibration
        self._kp, self._kd = kp, kd
        self._force_limit_n = config.gripper_force_limit_n
        self._path = None if config.calibration_path is None else Path(config.calibration_path)
        self._configured = None if config.gripper_stops_rad is None else GripperStops(*config.gripper_stops_rad)
        self.stops: GripperStops | None = None
        self._proven: GripperStops | None = None
        self._search: Search | None = None
        self._push = (0.0, kd)
        self._limiter: ForceLimiter | None = None
        self._grip = GripForce()
        self._anew = self._may_fail = False

    @property
    def searching(self) -> bool:
        """Whether the stops are being searched or verified."""
        return self._search is not None

    @property
    def force_limited(self) -> bool:
        """Whether the limiter reduces the squeeze."""
        return self._limiter is not None and self._limiter.clogged

    @property
    def stalled(self) -> bool:
        """Whether the gripper holds an object with reduced force, after a long press."""
        return self._grip.stalled

    def derate(self, level: float) -> None:
        """Reduce the grip force by the motor's heat level, 0 cool … 1 at the motor's thermal shutdown."""
        self._grip.derate(level)

    def begin(self, calibrate: bool = False) -> None:
        """Start verifying the known stops, or start a search if no stops are known or `calibrate` is set.

        Priority: stops found or verified in this session, then configured stops, then stored stops.

        Raises:
            GripperError: the stored stops are damaged or impossible.
        """
        known = self._proven or self._configured
        if calibrate:
            known = None
        elif known is None:
            if self._path is not None:
                known = load_stops(self._name, self._path, self._profile.name)
            if known is None:
                logger.warning("%s: no gripper stops are known; searching them, keep the fingers free", self._name)
        self._anew, self._may_fail = known is None, False
        if known is None:
            self._search = find_stops(self._name, self._calibration)
        else:
            self._search = verify_stops(self._name, self._calibration, known)
        self.stops = self._limiter = None
        self._push = next(self._search)

    def begin_if_known(self) -> None:
        """Start verifying known stops before a calibration; missing or wrong stops cause no search and no error."""
        try:
            if self._configured is None and (
                self._path is None or load_stops(self._name, self._path, self._profile.name) is None
            ):
                return
            self.begin()
            self._may_fail = True
        except GripperError as error:
            self._put_aside(error)

    def _put_aside(self, error: GripperError) -> None:
        logger.warning("%s; its stops are unknown until then", error)
        self.stop_search()

    def advance(self, now: float, motor_rad: float) -> float | None:
        """Advance the search by one tick. Return the shift of the reading, rad, once the stops are known, else None.

        Raises:
            GripperError: the search failed.
        """
        assert self._search is not None
        try:
            self._push = self._search.send((now, motor_rad))
        except StopIteration as found:
            self._search = None
            stops = GripperStops(found.value.closed_rad, found.value.open_rad)
            self._use(stops)
            if self._anew and self._configured is not None:
                what = "%s: `gripper_stops_rad` is configured and counts again from the next start; set it to "
                what += "[%.3f, %.3f] or remove it to use what was found now"
                logger.warning(what, self._name, stops.closed_rad, stops.open_rad)
            if self._anew and self._path is not None:
                try:
                    threading.Thread(target=self._store, args=(self._path, stops), daemon=True).start()
                except RuntimeError as error:
                    logger.error("%s: the gripper's stops are not stored: %s", self._name, error)
            return float(found.value.shift_rad)
        except GripperError as error:
            if self._may_fail:
                self._put_aside(error)
                return None
            self.stop_search()
            raise
        return None

    def _store(self, path: Path, stops: GripperStops) -> None:
        """Write the stops to a file, in a thread: a file system may block for longer than the motors' watchdog."""
        try:
            save_stops(self._name, path, self._profile.name, stops)
        except GripperError as error:  # the arm remains usable; `await_stored` reports the missing file
            logger.error("%s", error)

    def adopt(self, closed_rad: float, open_rad: float) -> None:
        """Use stops that another loop has verified; NaN: stops unknown, the motor is kept still."""
        if np.isfinite([closed_rad, open_rad]).all():
            self._use(GripperStops(closed_rad, open_rad))
        else:
            self.stop_search()

    def _use(self, stops: GripperStops) -> None:
        self.stops = self._proven = stops
        if self._force_limit_n is not None and self._profile.limiter is not None:
            ends = (stops.closed_rad, stops.open_rad)
            self._limiter = ForceLimiter(self._profile.limiter, self._kp, ends, self._force_limit_n)

    def stop_search(self) -> None:
        """Abort the search and keep the motor still."""
        self._search = None
        self._push = (0.0, self._kd)

    def normalised(self, motor_rad: float, motor_rate: float) -> tuple[float, float]:
        """Return position, 0 closed … 1 open, and rate, 1/s; zeros while the stops are unknown."""
        if self.stops is None:
            return 0.0, 0.0
        return self.stops.normalised(motor_rad), motor_rate / self.stops.span_rad

    def command(
        self, row: np.ndarray, now: float, u: float, u_rate: float, motor_rad: float, rate: float, tau: float
    ) -> None:
        """Fill the gripper's command row for a set-point `u` moving at `u_rate`; rate, tau: measured, 1/s and Nm."""
        if self.stops is None:
            speed, kd = self._push
            row[:] = motor_rad, speed, 0.0, kd, 0.0
            return
        span = self.stops.span_rad
        outwards = tau if span > 0.0 else -tau
        u_now = self.stops.normalised(motor_rad)
        if self._grip.update(now, u, u_now, rate, outwards):
            self._tell_stall()
        target = self.stops.motor(u)
        row[mit_laws.DQ] = u_rate * span
        if self._limiter is not None and u > u_now:
            self._limiter.release(now, tau)
            self._limiter.sent(target)
        elif self._limiter is not None:
            assert self._force_limit_n is not None
            self._limiter.max_force_n = self._force_limit_n * self._grip.factor
            limited = self._limiter.limit(now, target, motor_rad, rate, tau)
            low, high = sorted((self.stops.closed_rad, self.stops.open_rad))
            target = min(max(limited, low), high)
            self._limiter.sent(target)
            if self._limiter.clogged:
                row[mit_laws.DQ] = 0.0
        row[mit_laws.Q] = target
        if not self.force_limited:
            self._clip(row, motor_rad, rate * span)

    def _clip(self, row: np.ndarray, motor_rad: float, motor_rate: float) -> None:
        """Clip the torque while no limiter acts: for a gripper without limiter, or one that presses outwards."""
        most = self._torque_limit_nm
        if self._grip.stalled:
            most = min(most, self._grip.press_nm)
        if most * self._grip.factor < self._torque_limit_nm:
            limit = np.array([most * self._grip.factor])
            mit_laws.clip_torque(row[np.newaxis], np.array([motor_rad]), np.array([motor_rate]), limit)

    def _tell_stall(self) -> None:
        if self._grip.opening:
            what = "%s: the gripper is blocked while it opens and eases off; if nothing is in its way, its stops are "
            logger.warning(what + "wrong: calibrate again (lerobot-calibrate)", self._name)
        else:
            logger.info("%s: the gripper holds an object; easing off to spare its motor", self._name)
