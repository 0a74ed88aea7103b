"""Whether a motor can have done what its answer says, since its last good one.

With v the speeds of both answers, Δt the time between their samples and a the largest acceleration of the motor:

    min(v₀, v₁) Δt − s  ≤  q₁ − q₀  ≤  max(v₀, v₁) Δt + s,     s = noise + min(½ a Δt, u) Δt
    |v₁|  ≤  |v₀| + min(a Δt, 2u) + noise

The bare rotor of a small motor could gain more speed unseen than u = 5 rad/s, but no joint of an arm is as light. A
gripper is: its fingers open and close within half a second.

A blow may stop a joint at once, and is inside. A reading that is not is never used; it is forgotten but counted. When
several come within a short time the motor is not believed any more, until somebody says so (`restart`): a lie that
lasts would come within reach of the last good answer as that grows older.
"""

import math
from collections.abc import Iterable, Sequence

from lerobot_robot_yam.damiao.tables import MotorType

_NOISE_RAD = 0.005  # play in the gears and 13 codes of a position
_NOISE_RAD_S = 0.5
_UNSEEN_RAD_S = 5.0  # mean speed of a joint between two samples, beyond what both say
_DOUBTS = 4  # answers that cannot be, of which one is forgotten for every so many good ones
_FORGET = 1.0 / 50.0


class Plausibility:
    """Of the motors of a chain. Lists and plain floats: it looks at each frame.

    Args:
        types: of the motors.
        light: per motor, whether it moves next to nothing, as a gripper's does.

    Attributes:
        rejected: per motor, answers that could not be, in total.
        distrusted: per motor, whether its answers are not used any more.
    """

    def __init__(self, types: Sequence[MotorType], light: Sequence[bool]):
        count = len(types)
        speeds = zip(types, light, strict=True)
        self._unseen = [row.velocity_max_rad_s if free else _UNSEEN_RAD_S for row, free in speeds]
        self._acceleration = [row.acceleration_max_rad_s2 for row in types]
        self._q = [math.nan] * count  # rad, the last good one
        self._dq = [0.0] * count
        self._at_s = [math.nan] * count
        self._doubt = [0.0] * count
        self.rejected = [0] * count
        self.distrusted = [False] * count

    def restart(self, motors: Iterable[int]) -> None:
        """Believe the next answers of these motors, whatever they say."""
        for i in motors:
            self._q[i], self._doubt[i], self.distrusted[i] = math.nan, 0.0, False

    def distrust(self, motors: Iterable[int]) -> None:
        """Believe nothing that these motors say."""
        for i in motors:
            self.distrusted[i] = True

    def assume(self, motor: int, q: float, dq: float, at_s: float) -> None:
        """Judge the next answer by this one, which somebody else has had."""
        self._q[motor], self._dq[motor], self._at_s[motor] = q, dq, at_s

    def accept(self, motor: int, q: float, dq: float, sampled_s: float, latest_s: float) -> bool:
        """Whether an answer can be believed. Hot: once per frame.

        Args:
            motor: by index.
            q, dq: rad, rad/s.
            sampled_s, latest_s: when its sample was taken: most likely, and at the latest.
        """
        if self.distrusted[motor]:
            self.rejected[motor] += 1
            return False
        before = self._dq[motor]
        least_s, most_s = sampled_s - self._at_s[motor], latest_s - self._at_s[motor]
        low, high = (before, dq) if before < dq else (dq, before)
        gained = self._acceleration[motor] * most_s
        slack = _NOISE_RAD + min(0.5 * gained, self._unseen[motor]) * most_s
        step = q - self._q[motor]
        # NaN at first: nothing is beyond it.
        if (
            step > high * (most_s if high > 0.0 else least_s) + slack
            or step < low * (most_s if low < 0.0 else least_s) - slack
            or abs(dq) - abs(before) > min(gained, 2.0 * self._unseen[motor]) + _NOISE_RAD_S
        ):
            self.rejected[motor] += 1
            self._doubt[motor] += 1.0
            self.distrusted[motor] = self._doubt[motor] > _DOUBTS - 0.5
            return False
        self._q[motor], self._dq[motor], self._at_s[motor] = q, dq, sampled_s
        if self._doubt[motor] > 0.0:
            self._doubt[motor] = max(0.0, self._doubt[motor] - _FORGET)
        return True
