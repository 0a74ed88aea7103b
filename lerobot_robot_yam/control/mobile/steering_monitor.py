"""Monitor of the steering motors: one that does not turn although it is commanded to is stalled."""

import math

import numpy as np

from lerobot_robot_yam.control.mobile.rail_monitor import Finding
from lerobot_robot_yam.mobile.base_profile import CASTERS
from lerobot_robot_yam.mobile.resolved_base import ResolvedBase
from lerobot_robot_yam.state.faults import Trouble

_ASKED_RAD_S = 1.0  # commanded rate from which a stall is judged
_SHARE = 0.2  # share of the commanded rate below which a motor counts as stalled
_STALL_S = 0.3  # duration of a stall, s; a motor that starts is slow for a shorter time


class SteeringMonitor:
    """Monitor of four steering motors. Check once per tick."""

    def __init__(self, hardware: ResolvedBase):
        self._name, self._motors = hardware.name, hardware.motors[0:8:2]
        self._since_s: np.ndarray = np.full(len(CASTERS), math.inf)

    def forget(self) -> None:
        """Start anew, after a fault has been cleared."""
        self._since_s[:] = math.inf

    def check(self, now: float, asked: np.ndarray, measured: np.ndarray) -> Finding | None:
        """Return the trouble of stalled motors. asked, measured: (4,) rad/s in joint coordinates."""
        stalls = (np.abs(asked) > _ASKED_RAD_S) & (measured * np.sign(asked) < _SHARE * np.abs(asked))
        self._since_s = np.where(stalls, np.minimum(self._since_s, now), math.inf)
        stalled = np.flatnonzero(now - self._since_s > _STALL_S)
        if not len(stalled):
            return None
        names = ", ".join(f"{self._motors[i].name} (id {self._motors[i].can_id})" for i in stalled)
        return Trouble.STEERING_STALLED, f"{self._name}: {names} does not steer; free the caster, then re-arm"
