"""The set-point: where the arm is asked to be at this tick, and how fast it is asked to move there.

Callers send targets at 30–60 Hz; the loop runs at 250 Hz. Each new target is reached after about one caller period,
in a straight line per joint, so the arm sees ramps and not steps, and the ramp's slope is given to the motors as dq*
(without it, kd alone makes these gains lag by 60–150 ms). Speed and acceleration are limited always, the
ends of the range are approached slowly, and nothing jumps.
"""

import math

import numpy as np

_PERIOD_RANGE_S = (1 / 250, 0.1)  # caller periods outside are not a stream
_PERIOD_GAIN = 0.2  # smoothing of the measured caller period
_STREAM_GAP = 1.5  # caller periods without a target after which the stream counts as ended


class SetPoint:
    """Speed- and acceleration-limited set-point of n coordinates.

    Args:
        speed_limit: (n,) largest |dq*|, unit/s.
        acceleration_limit: (n,) largest |d dq*/dt|, unit/s².
        lower, upper: (n,) range that the set-point never leaves; seeded outside, it only moves inwards.
        end_deceleration: (n,) with which it comes to rest at an end of the range, unit/s².
    """

    def __init__(
        self,
        speed_limit: np.ndarray,
        acceleration_limit: np.ndarray,
        lower: np.ndarray,
        upper: np.ndarray,
        end_deceleration: np.ndarray,
    ):
        self.speed_limit = np.array(speed_limit, dtype=float)
        # What it can brake for: the target, the lower and the upper end. In one array, as numpy's calls are what costs.
        self._decelerations = np.array((acceleration_limit, end_deceleration, end_deceleration), dtype=float)
        self.acceleration_limit = self._decelerations[0]
        self._lower, self._upper = lower, upper
        n = len(self.speed_limit)
        self._ways = np.zeros((3, n))
        self.q: np.ndarray = np.zeros(n)
        self.dq: np.ndarray = np.zeros(n)
        self.target: np.ndarray = np.zeros(n)
        self._target_velocity: np.ndarray = np.zeros(n)
        self._target_at = -math.inf
        self._arrive_at = -math.inf
        self._period = 1 / 30
        self._given_velocity = False

    def seed(self, q: np.ndarray) -> None:
        """Start again, at rest, from the measured position (n,)."""
        self.q[:] = q
        self.dq[:] = 0.0
        self.target[:] = q
        self._target_velocity[:] = 0.0
        self._target_at = self._arrive_at = -math.inf

    def reseed(self, index: int, value: float) -> None:
        """Start one coordinate again, at rest, from its measured value."""
        self.q[index] = self.target[index] = value
        self.dq[index] = self._target_velocity[index] = 0.0

    def fall_back(self, index: int, value: float) -> None:
        """As `reseed`, but its target stays: it goes there from its measured value."""
        self.q[index], self.dq[index] = value, 0.0

    def aim(self, target: np.ndarray, now: float, velocity: np.ndarray | None = None) -> None:
        """Take a new target (n,), to be reached within about one caller period if the limits allow it.

        `velocity` (n,) is the speed with which the target itself moves, when the caller knows it; otherwise it is
        the difference to the previous target.
        """
        gap = now - self._target_at
        low, high = _PERIOD_RANGE_S
        if low <= gap <= high:
            self._period += _PERIOD_GAIN * (gap - self._period)
            own = (target - self.target) / self._period
        else:
            own = np.zeros_like(self.q)
        # A target that is quicker than the set-point may be would take it along, away from where the target is.
        most = self.speed_limit
        self._target_velocity = np.minimum(np.maximum(own if velocity is None else velocity, -most), most)
        self.target = np.minimum(np.maximum(target, self._lower), self._upper)
        self._target_at = now
        self._arrive_at = now + self._period

    def stop(self) -> None:
        """Forget the target: come to rest where the limits allow."""
        braking = self.dq * np.abs(self.dq) / (2 * self.acceleration_limit)
        self.target = np.minimum(np.maximum(self.q + braking, self._lower), self._upper)
        self._target_velocity[:] = 0.0
        self._arrive_at = -math.inf

    def advance(self, now: float, dt: float) -> None:
        """Move `q` and `dq` on by one tick of `dt` seconds, if any.

        v = (target − q) / time left, within the speed from which the remaining way still allows to slow down to the
        target's own speed: |v − v_target| ≤ sqrt(2 a |target − q|).
        """
        if dt <= 0.0:
            return
        if now - self._target_at > _STREAM_GAP * self._period:
            self._target_velocity[:] = 0.0
        gap = self.target - self.q
        left = max(self._arrive_at - now, dt)
        to_target, to_lower, to_upper = self._ways
        np.abs(gap, out=to_target)
        np.subtract(self.q, self._lower, out=to_lower)
        np.subtract(self._upper, self.q, out=to_upper)
        room, down, up = _brakes_within(self._ways, self._decelerations, dt)
        wanted = np.minimum(np.maximum(gap / left, self._target_velocity - room), self._target_velocity + room)
        # A moving target takes the set-point to the end of the range at full speed; the joint's stop is there.
        down, up = np.minimum(self.speed_limit, down), np.minimum(self.speed_limit, up)
        wanted = np.minimum(np.maximum(wanted, -down), up)
        step = self.acceleration_limit * dt
        self.dq += np.minimum(np.maximum(wanted - self.dq, -step), step)
        q = self.q + self.dq * dt
        self.q = np.minimum(np.maximum(q, np.minimum(self._lower, self.q)), np.maximum(self._upper, self.q))
        self.dq = np.where(self.q == q, self.dq, 0.0)

    @property
    def arrived(self) -> bool:
        """True when the set-point rests on its target."""
        return bool(np.all(np.abs(self.target - self.q) < 1e-4) and np.all(np.abs(self.dq) < 1e-2))


def _brakes_within(ways: np.ndarray, decelerations: np.ndarray, dt: float) -> np.ndarray:
    """The speeds from which `ways` suffice to come to rest, sqrt(2 a way); 0 where none is left. All (3, n)."""
    ways = np.maximum(ways, 0.0)
    # One tick is the resolution: without the floor the last steps would shrink for ever.
    return np.minimum(np.sqrt(2.0 * decelerations * ways), ways / dt)
