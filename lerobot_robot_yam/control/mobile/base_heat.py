"""Heat of a base's motors: a WARM motor halves the speed, a HOT one stops the base before it switches itself off."""

import math

from lerobot_robot_yam.control.mobile.rail_monitor import Finding
from lerobot_robot_yam.control.safety.thermal_monitor import Stage, ThermalMonitor, trips_c
from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.state.faults import Trouble

_PERIOD_S = 0.1  # period of temperature checks, s: temperatures change slowly


class BaseHeat:
    """Thermal monitor of one base.

    Attributes:
        share: share of the speed that is allowed now.
    """

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
