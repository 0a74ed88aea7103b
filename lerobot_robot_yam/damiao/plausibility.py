"""Plausibility check of motor replies: is a reading physically possible after the last good one?

With v the speeds of both readings, Δt the time between their samples, δt the time since the last reply of any kind and
a the maximum acceleration of the motor, a reading is possible if

    min(v₀, v₁) Δt − s  ≤  q₁ − q₀  ≤  max(v₀, v₁) Δt + s,     s = noise + min(½ a δt, u) δt
    |v₁|  ≤  |v₀| + min(a Δt, g) + noise

From one tick to the next, the bare rotor of a small motor could gain more speed than g = 2.5 rad/s, and more on average
than u = 2 rad/s. No joint of an arm is that light, but a gripper is: it opens and closes within half a second.
During a silence a hand may have snatched at a joint, which then moves up to 0.24 rad farther, at up to 5 rad/s.
Whatever delays an adapter adds, a joint turns by at most 0.5 rad between two readings and gains at most 10 rad/s.

What many samples may hide, a sum over half a second shows: the part of  q₁ − q₀  outside  min(v) Δt … max(v) Δt,  less
a fiftieth of the way, adds up to 0.03 rad at most, and that of a gripper to 0.3 rad. So a position that creeps while
the speed says otherwise is found within this distance, if no reply is lost meanwhile: then the sum begins anew.

A reading beyond these bounds is never used, only counted. In three cases the reading is kept until the next one, which
is then also compared with the kept reading:

- Only the speed is out of bounds: a blow can change a joint's speed at once, but not its position.
- A joint's reading is within the bounds only because there was a silence of more than 0.02 s.
- The reading is within the bounds only if the adapter's delay has just changed: then the sample is only known to have
  been taken between sending the command and receiving the reply.

A motor with several impossible readings in a short time is distrusted, until the caller calls `restart`.
"""

import math
from collections.abc import Iterable, Sequence

from lerobot_robot_yam.damiao.tables import MotorType

PERIOD_S = 0.004
"""Period of a control loop at its usual rate, s."""
_NOISE_RAD = 0.005  # noise of a position, rad: backlash of the gears, 13 codes
_NOISE_RAD_S = 0.5  # noise of a speed, rad/s
_UNSEEN_RAD_S = 2.0  # mean speed, beyond both reported speeds, that a joint can have between two samples, rad/s
_SNATCHED_RAD_S, _SNATCHED_RAD = (
    5.0,
    0.24,
)  # mean speed, rad/s, and distance, rad, that a joint can move when a hand snatches at it during a silence
_AWAY_RAD, _BLOW_RAD_S = 0.5, 10.0  # maximum distance, rad, and gain of speed, rad/s, of a joint between two samples
_GAINED_RAD_S = 2.5  # maximum gain of a joint's speed from one sample to the next, rad/s
_DOUBTS = 4  # number of impossible readings after which a motor is distrusted
_FORGET = 1.0 / 50.0  # number of impossible readings that one good reading offsets

_DRIFT_RAD, _LIGHT_DRIFT_RAD = 0.03, 0.3  # maximum sum of distances that the speeds do not explain, rad
_DRIFT_S = 0.5  # time in which the sum is forgotten, s
_DRIFT_SHARE = 0.02  # share of a distance that need not be explained: speeds are filtered, and known to 1/4096

_SURE_TICKS = 1.5  # longest time between two samples of which none is lost, in periods of the loop
_UNHEARD_S = 0.02  # silence after which a single reading is not trusted, s: five ticks


_Sample = tuple[float, float, float, float, float, float]
"""Position, rad; speed, rad/s; most likely and latest time of sampling if the adapter's delay is unchanged, s; times of
the request and of the reply, s."""

_NOTHING: _Sample = (math.nan,) * 6  # sample that makes every next reading possible


class Plausibility:
    """Plausibility check for the motors of a chain. Uses lists and plain floats for speed: it runs for each frame.

    Args:
        types: types of the motors.
        light: per motor, whether its load has next to no mass, as in a gripper.
        period_s: period of the control loop, s.

    Attributes:
        crept: per motor, distance by which its position has crept without a speed, rad.
        rejected: per motor, number of impossible readings so far.
        distrusted: per motor, whether its readings are no longer used.
    """

    def __init__(self, types: Sequence[MotorType], light: Sequence[bool], period_s: float = PERIOD_S):
        count = len(types)
        rows = list(zip(types, light, strict=True))
        self._light, self._sure_s = list(light), _SURE_TICKS * period_s
        self._unseen = [row.velocity_max_rad_s if free else _UNSEEN_RAD_S for row, free in rows]
        self._gained = [2.0 * row.velocity_max_rad_s if free else _GAINED_RAD_S for row, free in rows]
        self._acceleration = [row.acceleration_max_rad_s2 for row in types]
        self._drift = [0.0] * count  # sum of the distances that the speeds do not explain, rad
        self.crept = [0.0] * count
        self._drift_most = [_LIGHT_DRIFT_RAD if free else _DRIFT_RAD for free in light]
        self._good: list[_Sample] = [_NOTHING] * count
        self._struck: list[_Sample | None] = [None] * count  # kept sample, to be compared with the next one
        self._heard_s = [math.nan] * count
        self._doubt = [0.0] * count
        self.rejected = [0] * count
        self.distrusted = [False] * count

    def restart(self, motors: Iterable[int]) -> None:
        """Accept the next reading of each of these motors without a check."""
        for i in motors:
            self._good[i], self._struck[i], self._doubt[i], self.distrusted[i] = _NOTHING, None, 0.0, False
            self._drift[i] = self.crept[i] = 0.0

    def distrust(self, motors: Iterable[int]) -> None:
        """Reject all further readings of these motors."""
        for i in motors:
            self.distrusted[i] = True

    def assume(self, motor: int, q: float, dq: float, at_s: float) -> None:
        """Compare the motor's next reading with this sample, which another object has received."""
        self._good[motor], self._heard_s[motor] = (q, dq, at_s, at_s, at_s, at_s), at_s

    def accept(
        self, motor: int, q: float, dq: float, sampled_s: float, latest_s: float, asked_s: float, arrived_s: float
    ) -> bool:
        """Return whether a reading is plausible. Hot: once per frame.

        Args:
            motor: index of the motor.
            q, dq: position, rad, and speed, rad/s.
            sampled_s, latest_s: most likely and latest time of sampling.
            asked_s, arrived_s: times of the request and of the reply; the sample was certainly taken between them.
        """
        since_s, self._heard_s[motor] = latest_s - self._heard_s[motor], latest_s
        if self.distrusted[motor]:
            self.rejected[motor] += 1
            return False
        sample = (q, dq, sampled_s, latest_s, asked_s, arrived_s)
        slack = self._slack(motor, since_s if self._light[motor] else min(since_s, _UNHEARD_S))
        struck = self._struck[motor]
        if struck is not None:  # the rare case
            self._struck[motor] = None
            if not abs(_unexplained(struck, sample)) > slack:
                self._good[motor], self._drift[motor], self.crept[motor] = sample, 0.0, 0.0
                self._doubt[motor] = max(0.0, self._doubt[motor] - 1.0)
                return True
        good = self._good[motor]
        faster = abs(dq) - abs(good[1])
        leaps = abs(q - good[0]) > _AWAY_RAD or faster > _BLOW_RAD_S
        if leaps and not self._light[motor]:
            pass  # rejected without keeping the sample: no later reading could make such a leap possible
        elif not abs(beyond := _unexplained(good, sample)) > slack:  # NaN: nothing to compare with
            gained = min(self._acceleration[motor] * (latest_s - good[2]), self._gained[motor])
            if faster > gained + _NOISE_RAD_S:
                self._struck[motor] = sample
            elif not self._drifts(motor, beyond, q - good[0], since_s):
                self._good[motor] = sample
                if self._doubt[motor] > 0.0:
                    self._doubt[motor] = max(0.0, self._doubt[motor] - _FORGET)
                return True
        elif self._may_continue(motor, good, sample, since_s):
            self._struck[motor] = sample
        self.rejected[motor] += 1
        self._doubt[motor] += 1.0
        self.distrusted[motor] = self._doubt[motor] > _DOUBTS - 0.5
        return False

    def _drifts(self, motor: int, beyond: float, moved: float, since_s: float) -> bool:
        """Return whether unexplained distances add up to too much, with this one of `beyond` rad, of `moved` in all."""
        keeps, drift = 1.0 - since_s / _DRIFT_S, self._drift[motor]
        if beyond == 0.0 == drift:
            return False
        if since_s > self._sure_s:  # after a loss neither its speed nor the time of its sample is certain
            self._drift[motor] = self.crept[motor] = 0.0
            return False
        crept = 0.0
        if beyond:
            beyond = math.copysign(max(abs(beyond) - _DRIFT_SHARE * abs(moved), 0.0), beyond)
            if beyond * moved > 0.0:  # else the speed is wrong, not the position
                crept = beyond if abs(beyond) < abs(moved) else moved
        keeps = keeps if keeps > 0.0 else 0.0
        drift = drift * keeps + beyond
        if abs(drift) > self._drift_most[motor]:
            return True
        self._drift[motor], self.crept[motor] = drift, self.crept[motor] * keeps + crept
        return False

    def _slack(self, motor: int, unheard_s: float) -> float:
        """Return how far a motor can move in `unheard_s` beyond the distance that its speeds explain, rad."""
        return _NOISE_RAD + min(0.5 * self._acceleration[motor] * unheard_s, self._unseen[motor]) * unheard_s

    def _may_continue(self, motor: int, before: _Sample, after: _Sample, unheard_s: float) -> bool:
        """Return whether a motor can have moved so during a silence, or if the adapter's delay has changed."""
        slack = self._slack(motor, unheard_s)
        if unheard_s > _UNHEARD_S and not self._light[motor]:
            slack = min(slack + _SNATCHED_RAD, _NOISE_RAD + _SNATCHED_RAD_S * unheard_s)
        return not abs(_beyond(before, after, after[4] - before[5], after[5] - before[4])) > slack


def _unexplained(before: _Sample, after: _Sample) -> float:
    """Return how far a joint has moved beyond what its speeds explain, rad, if the adapter's delay is unchanged."""
    return _beyond(before, after, after[2] - before[3], after[3] - before[2])


def _beyond(before: _Sample, after: _Sample, least_s: float, most_s: float) -> float:
    """Return how far a joint has moved beyond what its speeds explain within least_s … most_s, rad; 0: not beyond."""
    least_s = least_s if least_s > 0.0 else 0.0
    low, high = (before[1], after[1]) if before[1] < after[1] else (after[1], before[1])
    step = after[0] - before[0]
    most = high * (most_s if high > 0.0 else least_s)
    if step > most:
        return step - most
    least = low * (most_s if low < 0.0 else least_s)
    return step - least if step < least else 0.0
