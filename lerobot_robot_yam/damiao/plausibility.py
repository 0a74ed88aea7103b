"""Whether a motor can have done what its answer says, since its last good one.

With v the speeds of both answers, Δt the time between their samples, δt the time since the last answer of any kind and
a the largest acceleration of the motor:

    min(v₀, v₁) Δt − s  ≤  q₁ − q₀  ≤  max(v₀, v₁) Δt + s,     s = noise + min(½ a δt, u) δt
    |v₁|  ≤  |v₀| + min(a Δt, 2u) + noise

The bare rotor of a small motor could gain more speed unseen than u = 5 rad/s, but no joint of an arm is as light. A
gripper is: its fingers open and close within half a second.

A reading that is not within is never used; it is forgotten but counted. A blow may give a joint more speed than that,
but it does not move it at once: a reading that is beyond by its speed alone waits for the next one, which is judged by
it. When several readings that cannot be come within a short time the motor is not believed any more, until somebody
says so (`restart`).
"""

import math
from collections.abc import Iterable, Sequence

from lerobot_robot_yam.damiao.tables import MotorType

_NOISE_RAD = 0.005  # play in the gears and 13 codes of a position
_NOISE_RAD_S = 0.5
_UNSEEN_RAD_S = 5.0  # mean speed of a joint between two samples, beyond what both say
_DOUBTS = 4  # answers that cannot be, of which one is forgotten for every so many good ones
_FORGET = 1.0 / 50.0

_Sample = tuple[float, float, float, float]  # q rad, dq rad/s, when most likely and at the latest, s
_NOTHING: _Sample = (math.nan, 0.0, math.nan, math.nan)  # nothing is beyond what follows it


class Plausibility:
    """Of the motors of a chain. Lists and plain floats: it looks at each frame.

    Args:
        types: of the motors.
        light: per motor, whether it moves next to nothing, as a gripper's does.

    Attributes:
        before: per motor, position (rad) and speed (rad/s) of the sample that the last good one was judged by.
        rejected: per motor, answers that could not be, in total.
        distrusted: per motor, whether its answers are not used any more.
    """

    def __init__(self, types: Sequence[MotorType], light: Sequence[bool]):
        count = len(types)
        speeds = zip(types, light, strict=True)
        self._unseen = [row.velocity_max_rad_s if free else _UNSEEN_RAD_S for row, free in speeds]
        self._acceleration = [row.acceleration_max_rad_s2 for row in types]
        self.before = [(math.nan, math.nan)] * count
        self._good: list[_Sample] = [_NOTHING] * count
        self._struck: list[_Sample | None] = [None] * count  # beyond by its speed alone
        self._heard_s = [math.nan] * count
        self._doubt = [0.0] * count
        self.rejected = [0] * count
        self.distrusted = [False] * count

    def restart(self, motors: Iterable[int]) -> None:
        """Believe the next answers of these motors, whatever they say."""
        for i in motors:
            self._good[i], self._struck[i], self._doubt[i], self.distrusted[i] = _NOTHING, None, 0.0, False

    def distrust(self, motors: Iterable[int]) -> None:
        """Believe nothing that these motors say."""
        for i in motors:
            self.distrusted[i] = True

    def assume(self, motor: int, q: float, dq: float, at_s: float) -> None:
        """Judge the next answer by this one, which somebody else has had."""
        self._good[motor], self._heard_s[motor] = (q, dq, at_s, at_s), at_s

    def accept(self, motor: int, q: float, dq: float, sampled_s: float, latest_s: float) -> bool:
        """Whether an answer can be believed. Hot: once per frame.

        Args:
            motor: by index.
            q, dq: rad, rad/s.
            sampled_s, latest_s: when its sample was taken: most likely, and at the latest.
        """
        since_s, self._heard_s[motor] = latest_s - self._heard_s[motor], latest_s
        if self.distrusted[motor]:
            self.rejected[motor] += 1
            return False
        unseen, sample = self._unseen[motor], (q, dq, sampled_s, latest_s)
        slack = _NOISE_RAD + min(0.5 * self._acceleration[motor] * since_s, unseen) * since_s
        struck = self._struck[motor]
        if struck is not None:  # hardly ever
            self._struck[motor] = None
            if _continues(struck, sample, slack):
                self.before[motor], self._good[motor] = struck[:2], sample
                self._doubt[motor] = max(0.0, self._doubt[motor] - 1.0)
                return True
        good = self._good[motor]
        if _continues(good, sample, slack):
            gained = min(self._acceleration[motor] * (latest_s - good[2]), 2.0 * unseen)
            if not abs(dq) - abs(good[1]) > gained + _NOISE_RAD_S:
                self.before[motor], self._good[motor] = good[:2], sample
                if self._doubt[motor] > 0.0:
                    self._doubt[motor] = max(0.0, self._doubt[motor] - _FORGET)
                return True
            self._struck[motor] = sample
        self.rejected[motor] += 1
        self._doubt[motor] += 1.0
        self.distrusted[motor] = self._doubt[motor] > _DOUBTS - 0.5
        return False


def _continues(before: _Sample, after: _Sample, slack: float) -> bool:
    """Whether a joint can have got from one sample to another; from none, always."""
    q_before, dq_before, early_s, late_s = before
    q, dq, sampled_s, latest_s = after
    least_s, most_s = max(0.0, sampled_s - late_s), latest_s - early_s
    low, high = (dq_before, dq) if dq_before < dq else (dq, dq_before)
    step = q - q_before
    beyond = step > high * (most_s if high > 0.0 else least_s) + slack
    return not (beyond or step < low * (most_s if low < 0.0 else least_s) - slack)
