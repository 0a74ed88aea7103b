"""Checks whether an answer of a motor is possible after its last good answer.

With v the speeds of both answers, Δt the time between their samples, δt the time since the last answer of any kind and
a the largest acceleration of the motor:

    min(v₀, v₁) Δt − s  ≤  q₁ − q₀  ≤  max(v₀, v₁) Δt + s,     s = noise + min(½ a δt, u) δt
    |v₁|  ≤  |v₀| + min(a Δt, g) + noise

The bare rotor of a small motor could gain more speed than g = 2.5 rad/s, and on average u = 2 rad/s, from one tick to
the next, but no joint of an arm is as light. Grippers are: their fingers open and close within half a second. After a
silence a hand may have snatched at a joint: it moves up to 0.24 rad farther, at up to 5 rad/s. Whatever an adapter does
to the times, a joint turns by no more than 0.5 rad between two readings, and gains no more than 10 rad/s.

A reading beyond these bounds is never used; it is forgotten but counted. Three kinds wait for the next reading, which
is then judged by them:

- beyond the bounds by its speed alone: a blow may give a joint more speed, but does not move it at once;
- within the bounds, for a joint, only because nothing was heard for more than 0.02 s;
- within the bounds only if the adapter has just become slower or quicker: then a sample is only known to have been
  taken after its command was sent and before its answer arrived.

When several impossible readings come within a short time the motor is distrusted, until somebody lifts that
(`restart`).
"""

import math
from collections.abc import Iterable, Sequence

from lerobot_robot_yam.damiao.tables import MotorType

_NOISE_RAD = 0.005  # noise of a position, rad: play in the gears, 13 codes
_NOISE_RAD_S = 0.5  # noise of a speed, rad/s
_UNSEEN_RAD_S = 2.0  # mean speed of a joint between two samples beyond both reported speeds, rad/s
_SNATCHED_RAD_S, _SNATCHED_RAD = (
    5.0,
    0.24,
)  # mean speed, rad/s, and way, rad, of a joint that a hand snatches in a silence
_AWAY_RAD, _BLOW_RAD_S = 0.5, 10.0  # largest way, rad, and gain of speed, rad/s, of a joint between two samples
_GAINED_RAD_S = 2.5  # gain of speed of a joint from one sample to the next, rad/s
_DOUBTS = 4  # impossible answers after which a motor is distrusted
_FORGET = 1.0 / 50.0  # impossible answers that one good answer cancels

_UNHEARD_S = 0.02  # silence, s, after which one reading is not enough: five ticks


_Sample = tuple[float, float, float, float, float, float]
"""Position, rad, and speed, rad/s; when it was taken: most likely, and at the latest, if the adapter is as it was; when
it was asked for, and when it arrived, s."""

_NOTHING: _Sample = (math.nan,) * 6  # a sample after which every answer is possible


class Plausibility:
    """Judge of the answers of the motors of a chain. Lists and plain floats are used, since each frame is judged.

    Args:
        types: types of the motors.
        light: per motor, whether it moves next to no mass, like a gripper's motor.

    Attributes:
        before: per motor, position (rad) and speed (rad/s) of the sample that the last good one was judged by.
        rejected: per motor, number of impossible answers so far.
        distrusted: per motor, whether its answers are not used any more.
    """

    def __init__(self, types: Sequence[MotorType], light: Sequence[bool]):
        count = len(types)
        rows = list(zip(types, light, strict=True))
        self._light = list(light)
        self._unseen = [row.velocity_max_rad_s if free else _UNSEEN_RAD_S for row, free in rows]
        self._gained = [2.0 * row.velocity_max_rad_s if free else _GAINED_RAD_S for row, free in rows]
        self._acceleration = [row.acceleration_max_rad_s2 for row in types]
        self.before = [(math.nan, math.nan)] * count
        self._good: list[_Sample] = [_NOTHING] * count
        self._struck: list[_Sample | None] = [None] * count  # sample that waits for the next one
        self._heard_s = [math.nan] * count
        self._doubt = [0.0] * count
        self.rejected = [0] * count
        self.distrusted = [False] * count

    def restart(self, motors: Iterable[int]) -> None:
        """Accept the next answer of each of these motors, whatever it says."""
        for i in motors:
            self._good[i], self._struck[i], self._doubt[i], self.distrusted[i] = _NOTHING, None, 0.0, False

    def distrust(self, motors: Iterable[int]) -> None:
        """Accept no answers of these motors."""
        for i in motors:
            self.distrusted[i] = True

    def assume(self, motor: int, q: float, dq: float, at_s: float) -> None:
        """Judge the next answer by this sample, which another object has received."""
        self._good[motor], self._heard_s[motor] = (q, dq, at_s, at_s, at_s, at_s), at_s

    def accept(
        self, motor: int, q: float, dq: float, sampled_s: float, latest_s: float, asked_s: float, arrived_s: float
    ) -> bool:
        """Return whether an answer can be believed. Hot: once per frame.

        Args:
            motor: index of the motor.
            q, dq: position, rad, and speed, rad/s.
            sampled_s, latest_s: when the sample was taken: most likely, and at the latest.
            asked_s, arrived_s: times between which the sample was certainly taken.
        """
        since_s, self._heard_s[motor] = latest_s - self._heard_s[motor], latest_s
        if self.distrusted[motor]:
            self.rejected[motor] += 1
            return False
        sample = (q, dq, sampled_s, latest_s, asked_s, arrived_s)
        slack = self._slack(motor, since_s if self._light[motor] else min(since_s, _UNHEARD_S))
        struck = self._struck[motor]
        if struck is not None:  # rarely
            self._struck[motor] = None
            if _continues(struck, sample, slack):
                self.before[motor], self._good[motor] = struck[:2], sample
                self._doubt[motor] = max(0.0, self._doubt[motor] - 1.0)
                return True
        good = self._good[motor]
        faster = abs(dq) - abs(good[1])
        leaps = abs(q - good[0]) > _AWAY_RAD or faster > _BLOW_RAD_S
        if leaps and not self._light[motor]:
            pass  # rejected at once: no later reading could make such a leap possible
        elif _continues(good, sample, slack):
            gained = min(self._acceleration[motor] * (latest_s - good[2]), self._gained[motor])
            if not faster > gained + _NOISE_RAD_S:
                self.before[motor], self._good[motor] = good[:2], sample
                if self._doubt[motor] > 0.0:
                    self._doubt[motor] = max(0.0, self._doubt[motor] - _FORGET)
                return True
            self._struck[motor] = sample
        elif self._may_continue(motor, good, sample, since_s):
            self._struck[motor] = sample
        self.rejected[motor] += 1
        self._doubt[motor] += 1.0
        self.distrusted[motor] = self._doubt[motor] > _DOUBTS - 0.5
        return False

    def _slack(self, motor: int, unheard_s: float) -> float:
        """Return how far a motor can get in that time beyond what its speeds explain, rad."""
        return _NOISE_RAD + min(0.5 * self._acceleration[motor] * unheard_s, self._unseen[motor]) * unheard_s

    def _may_continue(self, motor: int, before: _Sample, after: _Sample, unheard_s: float) -> bool:
        """Return whether a motor can have got there in a silence, or if the adapter has become slower or quicker."""
        slack = self._slack(motor, unheard_s)
        if unheard_s > _UNHEARD_S and not self._light[motor]:
            slack = min(slack + _SNATCHED_RAD, _NOISE_RAD + _SNATCHED_RAD_S * unheard_s)
        return _reaches(before, after, after[4] - before[5], after[5] - before[4], slack)


def _continues(before: _Sample, after: _Sample, slack: float) -> bool:
    """Return whether a joint can have moved from one sample to another, if the adapter's delay has not changed."""
    return _reaches(before, after, after[2] - before[3], after[3] - before[2], slack)


def _reaches(before: _Sample, after: _Sample, least_s: float, most_s: float, slack: float) -> bool:
    """Return whether a joint can have got from one sample to another within least_s … most_s."""
    least_s = least_s if least_s > 0.0 else 0.0
    low, high = (before[1], after[1]) if before[1] < after[1] else (after[1], before[1])
    step = after[0] - before[0]
    beyond = step > high * (most_s if high > 0.0 else least_s) + slack
    return not (beyond or step < low * (most_s if low < 0.0 else least_s) - slack)
