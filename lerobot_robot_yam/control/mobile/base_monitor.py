"""Monitors of a base's motors.

A motor that does not turn although it is commanded to is stalled. A WARM motor halves the speed, a HOT one stops the
base before it switches itself off.
"""

import math

import numpy as np

from lerobot_robot_yam.control.mobile.rail_monitor import Finding
from lerobot_robot_yam.control.safety.thermal_monitor import Stage, ThermalMonitor, trips_c
from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.mobile.base_profile import CASTERS
from lerobot_robot_yam.mobile.resolved_base import ResolvedBase
from lerobot_robot_yam.state.faults import Trouble

_PERIOD_S = 0.1  # period of temperature checks, s: temperatures change slowly
_ASKED_RAD_S = 1.0  # commanded rate from which a stall is judged; of a wheel this is 0.05 m/s
# Share of the commanded rate below which steering and wheel count as stalled: a blocked base still turns some wheels.
_SHARE = np.array([0.2, 0.5] * len(CASTERS))
_STALL_S = np.array([0.3, 0.5] * len(CASTERS))  # duration of a stall, s; a motor that starts is slow for a shorter time
_STEP_S = 0.02  # maximum time that one check counts for, s: while the loop pauses, nothing is known


class StallMonitor:
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


class BaseHeat:
    """Thermal monitor of one base. share: share of the speed that is allowed now."""

    def __init__(self, name: str, chain: MotorChain):
        self._name, self._chain, self.share = name, chain, 1.0
        self._monitor: ThermalMonitor | None = None
        self._due_s = -math.inf

    def inspect(self) -> None:
        """Read the temperatures at which the motors switch themselves off."""
        ot_value_c = [self._chain.read_register(i, Register.OT_VALUE) for i in range(len(self._chain))]
        self._monitor = ThermalMonitor(self._name, *trips_c(ot_value_c), [m.name for m in self._chain.motors])

    def check(self, now: float) -> Finding | None:
        """Update `share`; return the trouble of a HOT motor."""
        if self._monitor is None or now < self._due_s:
            return None
        self._due_s = now + _PERIOD_S
        heat = self._monitor.check(now, self._chain.temp_mos_c, self._chain.temp_rotor_c)
        self.share = heat.speed_scale
        return (Trouble.HOT, heat.message) if heat.stage is Stage.HOT else None
