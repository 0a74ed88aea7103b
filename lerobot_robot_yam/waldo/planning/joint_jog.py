"""Jogging of joints: a speed that holds for a moment, and brakes at its end, at a limit, or before a thing."""

import numpy as np

from lerobot_robot_yam.waldo.planning.motion_limits import JOG_SHARE
from lerobot_robot_yam.waldo.planning.planner import Planner


class JointJog:
    """One jog command; renewed as long as a button is held.

    Args:
        planner: of the arm.
        shares: (n,) signed, −1 … 1 of the jog speed.
        accel: share 0 … 1 of the acceleration limit, for speeding up; it always brakes with all of it.
        until_s: when it ends.

    Attributes:
        until_s: when it ends.
    """

    def __init__(self, planner: Planner, shares: np.ndarray, accel: float, until_s: float):
        self._planner, self._shares, self._accel, self.until_s = planner, shares, accel, until_s
        self._blocked = False

    def renewed(self, newer: "JointJog") -> "JointJog":
        """The newer command; what stood in the way of this one stands in the way of the same asked again."""
        newer._blocked = self._blocked and np.array_equal(newer._shares, self._shares)
        return newer

    def step(self, q: np.ndarray, dq: np.ndarray, now_s: float, dt_s: float) -> tuple[np.ndarray, np.ndarray]:
        """The set-point (n,) rad and its speed (n,) rad/s one tick after these."""
        limits = self._planner.limits
        if now_s < self.until_s and not self._blocked:
            there = self._towards(JOG_SHARE * limits.speed * self._shares, q, dq, dt_s)
            stop = there[0] + there[1] * np.abs(there[1]) / (2.0 * limits.acceleration)
            if self._planner.surroundings.first_conflict(np.array([q, stop])) is None:
                return there
            self._blocked = True
        return self._towards(np.zeros(len(q)), q, dq, dt_s)

    def _towards(self, wanted: np.ndarray, q: np.ndarray, dq: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
        planner, most = self._planner, self._planner.limits.acceleration
        gains = (np.abs(wanted) > np.abs(dq)) & (wanted * dq >= 0.0)
        step = np.where(gains, self._accel, 1.0) * most * dt
        speed = dq + np.clip(wanted - dq, -step, step)
        down, up = (speed_within(room, most, dt) for room in (q - planner.lower, planner.upper - q))
        speed = np.clip(speed, -down, up)
        return q + speed * dt, speed


def speed_within(room: np.ndarray, deceleration: np.ndarray, dt: float) -> np.ndarray:
    """The speed at which one more tick still leaves room to brake:  v dt + v² / 2a = room;  0 without any room."""
    return deceleration * (np.sqrt(dt**2 + 2.0 * np.maximum(room, 0.0) / deceleration) - dt)
