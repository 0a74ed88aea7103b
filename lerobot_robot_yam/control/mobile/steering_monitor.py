"""Monitor of steering and wheels: a motor that does not turn although it is commanded to is stalled."""

import math

import numpy as np

from lerobot_robot_yam.control.mobile.rail_monitor import Finding
from lerobot_robot_yam.mobile.base_profile import CASTERS
from lerobot_robot_yam.mobile.resolved_base import ResolvedBase
from lerobot_robot_yam.state.faults import Trouble

_ASKED_RAD_S = 1.0  # commanded rate from which a stall is judged; of a wheel this is 0.05 m/s
_SHARE = np.array([0.2, 0.5] * len(CASTERS))  # share of the commanded rate below which a motor counts as stalled:
# steering, wheel. A blocked base still turns some of its wheels, by their slip
_STALL_S = np.array([0.3, 0.5] * len(CASTERS))  # duration of a stall, s; a motor that starts is slow for a shorter time
_STEP_S = 0.02  # maximum time that one check counts for, s: while the loop pauses, nothing is known


class SteeringMonitor:
    """Monitor of the eight motors of four casters. Check once per tick.

    Time in which a motor turns is subtracted from its stalls: a base that bounces off an obstacle stalls repeatedly.
    """

    def __init__(self, hardware: ResolvedBase):
        self._name, self._motors = hardware.name, hardware.motors[: 2 * len(CASTERS)]
        self._stalled_s: np.ndarray = np.zeros(2 * len(CASTERS))
        self._checked_s = -math.inf

    def forget(self) -> None:
        """Start anew, after a fault has been cleared."""
        self._stalled_s[:] = 0.0

    def check(self, now: float, asked: np.ndarray, measured: np.ndarray) -> Finding | None:
        """Return the trouble of stalled motors. asked, measured: (8,) rad/s in joint coordinates."""
        stalls = (np.abs(asked) > _ASKED_RAD_S) & (measured * np.sign(asked) < _SHARE * np.abs(asked))
        dt, self._checked_s = min(now - self._checked_s, _STEP_S), now
        self._stalled_s = np.maximum(self._stalled_s + np.where(stalls, dt, -dt), 0.0)
        stalled = np.flatnonzero(self._stalled_s > _STALL_S)
        if not len(stalled):
            return None
        names = ", ".join(f"{self._motors[i].name} (id {self._motors[i].can_id})" for i in stalled)
        if (stalled % 2 == 0).any():
            return Trouble.STEERING_STALLED, f"{self._name}: {names} does not steer; free the caster, then re-arm"
        what = "does not turn as commanded: something is in the way, or a wheel is lifted or blocked"
        return Trouble.BASE_BLOCKED, f"{self._name}: {names} {what}; free it, then re-arm"
