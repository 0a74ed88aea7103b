"""Temperatures reported by one simulated motor, and its over-temperature faults."""

import random
from dataclasses import dataclass

from lerobot_robot_yam.damiao.tables import Fault

COIL_LIMIT_C = 100.0  # our choice for all motors; the limit of the power stage is register OT_VALUE
_REST_C = (35.5, 40.5)  # power stage and coil at rest; these values and the gains are from the vendor's simulation
_GAIN_C_PER_W = (0.5, 0.8)
_TIME_CONSTANT_S = (20.0, 60.0)  # time constants of power stage and coil; our estimate
PERIOD_S = 0.02  # interval between measurements, s; our choice


@dataclass(frozen=True)
class Ramp:
    """Temperature of both parts, which changes linearly from `from_c` at simulated time `since_s`."""

    rate_c_per_s: float
    from_c: float
    since_s: float

    def at(self, sim_s: float) -> float:
        """Return the temperature at simulated time `sim_s`, °C."""
        return self.from_c + self.rate_c_per_s * (sim_s - self.since_s)


class Thermometer:
    """Power stage ("mos") and coil ("rotor") of one motor, °C.

    held: fixed false readings, to which the motor does not react. ramp: a real change, to which the motor reacts.
    chance: source of the noise. word: the last measurement as two bytes of a feedback frame.
    """

    def __init__(self, chance: random.Random):
        self.held: tuple[float, float] | None = None
        self.ramp: Ramp | None = None
        self._chance = chance
        self._warmth = (0.0, 0.0)  # temperature rise above rest, °C
        self.measured_at_s = -PERIOD_S
        self._measured = _REST_C
        self.word = 0

    def read(self, velocity_rad_s: float, torque_nm: float, sim_s: float, sample_s: float) -> tuple[int, int]:
        """Return the temperatures of power stage and coil, °C, reported for a sample of monotonic time `sample_s`.

        Without a fault this is the vendor simulation's formula with a low-pass filter, because metal does not follow
        the power within a tick.
        """
        if not 0.0 <= sim_s - self.measured_at_s < PERIOD_S:
            self._measure(abs(velocity_rad_s * torque_nm), sim_s)
        mos, rotor = self._measured
        if self.held is not None:
            mos, rotor = self.held
        elif self.ramp is not None:
            mos = rotor = self.ramp.at(sim_s)
        return int(mos), int(rotor)

    def _measure(self, power_w: float, sim_s: float) -> None:
        elapsed_s, self.measured_at_s = max(0.0, sim_s - self.measured_at_s), sim_s
        mos, rotor = self._warmth
        mos += (_GAIN_C_PER_W[0] * power_w - mos) * min(elapsed_s / _TIME_CONSTANT_S[0], 1.0)
        rotor += (_GAIN_C_PER_W[1] * power_w - rotor) * min(elapsed_s / _TIME_CONSTANT_S[1], 1.0)
        self._warmth = mos, rotor
        noise = self._chance.random() - 0.5
        mos, rotor = self._measured = _REST_C[0] + mos + noise, _REST_C[1] + rotor + noise
        self.word = min(max(int(mos), 0), 0xFF) << 8 | min(max(int(rotor), 0), 0xFF)

    def tripped(self, mos_limit_c: float, sim_s: float) -> Fault | None:
        """Return the over-temperature fault that the motor enters, if any."""
        if self.ramp is None:
            return None
        warm = self.ramp.at(sim_s)
        if warm >= mos_limit_c:
            return Fault.MOS_OVER_TEMPERATURE
        return Fault.ROTOR_OVER_TEMPERATURE if warm >= COIL_LIMIT_C else None
