"""How near the motors are to switching themselves off for heat: an arm backs off before one of them does.

Two sensors per motor. Where they trip, by public sources on Damiao motors (a driver that quotes the DM9008 manual, and
Seeed Studio's page on the series): the power stage at a fixed 120 °C; the coil at register OT_VALUE, for which at most
100 °C is advised. It is not known which of the two sensors the register really guards, so both count as
tripping there.

    level = 0 … 1 over the 15 °C below the trip, the worse of the two sensors
    WARM    15 °C below the trip: half speed, less grip
    HOT      5 °C below: the arm lands while all its motors still obey

A temperature is believed once it has been steady for half a second. Coils warm up by 5 °C/s at the very most (60 W into
30 g of copper), so whatever moves faster is no temperature.
"""

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

logger = logging.getLogger(__name__)

MOS_TRIP_C = 120.0  # trip of the power stage, see above
COIL_TRIP_C = 100.0  # trip of the coil, see above
_OT_RANGE_C = (80.0, 200.0)  # range of OT_VALUE; any other value was never written
WARM_C = 15.0  # margin below the trip from which a motor is warm
HOT_C = 5.0
_HYSTERESIS_C = 3.0
_STEADY_C = 10.0  # largest change of a true temperature in _STEADY_S
_STEADY_S = 0.5
_WARM_SPEED = 0.5


class Stage(IntEnum):
    """Stage of a motor's warmth."""

    NONE = 0
    WARM = 1
    HOT = 2


@dataclass(frozen=True)
class Heat:
    """Heat of the motors of one arm.

    Attributes:
        level: (n,) heat level, 0 cool … 1 at the trip.
        stages: (n,) `Stage` of each motor.
        stage: stage of the warmest motor.
        message: WARM and HOT motors with both temperatures and trips; empty when there are none.
    """

    level: np.ndarray
    stages: np.ndarray
    stage: Stage = Stage.NONE
    message: str = ""

    @property
    def speed_scale(self) -> float:
        """Factor on the set-point's speed limits: 1, or one half as long as a motor is warm."""
        return _WARM_SPEED if self.stage else 1.0


def trips_c(ot_value_c: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Return where power stages and coils count as tripping, °C (n,) each, from registers OT_VALUE (n,)."""
    found = np.asarray(ot_value_c, dtype=float)
    low, high = _OT_RANGE_C
    set_to = np.where((found >= low) & (found < high), found, low)
    return np.minimum(set_to, MOS_TRIP_C), np.minimum(set_to, COIL_TRIP_C)


class ThermalMonitor:
    """Monitor of the temperatures of the n motors of one arm. Check once per tick.

    Args:
        arm: name for messages.
        mos_trip_c, rotor_trip_c: (n,) °C, where power stage and coil switch the motor off, see `trips_c`.
        names: (n,) names of the motors.
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
        """Return the heat after this tick's readings (n,), °C; `now` in s. NaN counts as no reading."""
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
        """Take over readings that can be temperatures; return whether any has changed."""
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
        """Return the stages: up at once, down only _HYSTERESIS_C further below."""
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
