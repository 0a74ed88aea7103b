"""Thermal monitor: reduces an arm's load, or lands the arm, before a motor's over-temperature shutdown.

Each motor has two sensors. Trip points according to public sources on Damiao motors (a driver that quotes the DM9008
manual, and Seeed Studio's page on the series): power stage fixed at 120 °C; coil at register OT_VALUE, recommended
maximum 100 °C. Which of the two sensors the register guards is unknown, so the register limits both sensors.

    level = 0 … 1 over the 15 °C below the trip point, for the worse of the two sensors
    WARM    15 °C below the trip point: half speed, less grip
    HOT      5 °C below the trip point: the arm lands while all its motors still obey

A temperature is accepted once steady for half a second. Coils warm up by at most 5 °C/s (60 W into 30 g of copper), so
faster changes are not real temperatures.
"""

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

logger = logging.getLogger(__name__)

MOS_TRIP_C = 120.0  # trip point of the power stage, see above
COIL_TRIP_C = 100.0  # maximum trip point of the coil, see above
_OT_RANGE_C = (80.0, 200.0)  # valid range of OT_VALUE; other values mean an unset register
WARM_C = 15.0  # margin below the trip point at which a motor becomes WARM
HOT_C = 5.0
_HYSTERESIS_C = 3.0
_STEADY_C = 10.0  # maximum change of a real temperature in _STEADY_S
_STEADY_S = 0.5
_WARM_SPEED = 0.5


class Stage(IntEnum):
    """Thermal stage of a motor."""

    NONE = 0
    WARM = 1
    HOT = 2


@dataclass(frozen=True)
class Heat:
    """Thermal state of one arm's motors.

    Attributes:
        level: (n,) heat level, 0 cool … 1 at the trip point.
        stages: (n,) `Stage` of each motor.
        stage: highest stage of all motors.
        message: WARM and HOT motors with temperatures and trip points of both sensors; empty: no such motor.
    """

    level: np.ndarray
    stages: np.ndarray
    stage: Stage = Stage.NONE
    message: str = ""

    @property
    def speed_scale(self) -> float:
        """Factor for the set-point's speed limits: 1, or 0.5 while any motor is WARM or HOT."""
        return _WARM_SPEED if self.stage else 1.0


def trips_c(ot_value_c: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Return the assumed trip points of power stages and coils, °C, (n,) each. ot_value_c: registers OT_VALUE (n,)."""
    found = np.asarray(ot_value_c, dtype=float)
    low, high = _OT_RANGE_C
    set_to = np.where((found >= low) & (found < high), found, low)
    return np.minimum(set_to, MOS_TRIP_C), np.minimum(set_to, COIL_TRIP_C)


class ThermalMonitor:
    """Temperature monitor for one arm with n motors. Check once per tick.

    Args:
        arm: name of the arm, for messages.
        mos_trip_c, rotor_trip_c: (n,) trip points of power stage and coil, °C, see `trips_c`.
        names: (n,) motor names.
    """

    def __init__(self, arm: str, mos_trip_c: np.ndarray, rotor_trip_c: np.ndarray, names: Sequence[str]):
        self._arm = arm
        self._names = tuple(names)
        n = len(self._names)
        self._trip = np.stack([np.broadcast_to(mos_trip_c, n), np.broadcast_to(rotor_trip_c, n)]).astype(float)
        self._believed: np.ndarray = np.full((2, n), math.nan)
        self._candidate: np.ndarray = np.full((2, n), math.nan)
        self._since: np.ndarray = np.zeros((2, n))
        self._stages = np.zeros(n, dtype=int)
        self._heat = Heat(np.zeros(n), self._stages)

    def check(self, now: float, temp_mos_c: np.ndarray, temp_rotor_c: np.ndarray) -> Heat:
        """Process this tick's readings (n,), °C, NaN without a reading; return the thermal state."""
        reading = np.array((temp_mos_c, temp_rotor_c))
        if not self._believe(now, reading):
            return self._heat
        margin = np.fmin.reduce(self._trip - self._believed)
        stages = self._stage(margin)
        self._log(stages)
        self._stages = stages
        level = np.minimum(np.maximum((WARM_C - np.nan_to_num(margin, nan=WARM_C)) / WARM_C, 0.0), 1.0)
        worst = Stage(int(stages.max(initial=0)))
        message = "; ".join(self._describe(i) for i in np.flatnonzero(stages)) if worst else ""
        self._heat = Heat(level, stages, worst, message)
        return self._heat

    def _believe(self, now: float, reading: np.ndarray) -> bool:
        """Accept plausible readings; return whether an accepted temperature may have changed."""
        near = np.abs(reading - self._believed) <= _STEADY_C
        if near.all():
            changed = bool((reading != self._believed).any())
            self._believed = self._candidate = reading
            self._since[:] = now
            return changed
        held = np.abs(reading - self._candidate) <= _STEADY_C
        self._candidate = np.where(held, self._candidate, reading)
        self._since = np.where(held & ~near, self._since, now)
        near |= held & (now - self._since >= _STEADY_S)
        self._believed = np.where(near, reading, self._believed)
        return True

    def _stage(self, margin: np.ndarray) -> np.ndarray:
        """Return the stages: upwards at once, downwards only with an additional margin of _HYSTERESIS_C."""
        up = (margin <= WARM_C).astype(int) + (margin <= HOT_C)
        down = (margin <= WARM_C + _HYSTERESIS_C).astype(int) + (margin <= HOT_C + _HYSTERESIS_C)
        return np.maximum(up, np.minimum(self._stages, down))

    def _describe(self, index: int) -> str:
        mos, coil = self._believed[:, index]
        mos_trip, coil_trip = self._trip[:, index]
        return (
            f"{self._names[index]}: power stage {mos:.0f} °C (trips at {mos_trip:.0f}), "
            f"coil {coil:.0f} °C (trips at {coil_trip:.0f})"
        )

    def _log(self, stages: np.ndarray) -> None:
        for index in np.flatnonzero((stages > 0) & (self._stages == 0)):
            logger.warning("%s: motor warm, backing off: %s", self._arm, self._describe(int(index)))
        for index in np.flatnonzero((stages == Stage.HOT) & (self._stages < Stage.HOT)):
            logger.error("%s: motor about to switch itself off: %s", self._arm, self._describe(int(index)))
        for index in np.flatnonzero((stages == 0) & (self._stages > 0)):
            logger.info("%s: cool again: %s", self._arm, self._describe(int(index)))
