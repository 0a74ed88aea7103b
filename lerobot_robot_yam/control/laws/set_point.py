"""The set-point: position and speed commanded to the arm at this tick.

Callers send targets at 30–60 Hz; the loop runs at 250 Hz. Each new target is reached after about one caller period,
on a linear ramp per joint, so that the arm sees no steps. The motors receive the ramp's slope as dq*: with dq* = 0 the
damping kd would make the arm lag by 60–150 ms. Speed and acceleration are always limited, the ends of the range are
approached slowly, and the set-point never jumps.

Each tick plans one step. The command is the weighted mean of the last three plans, with the acceleration computed from
the same three plans, so that position, speed and acceleration belong to one smooth motion. If the acceleration lagged
behind the speed, the arm would start late, catch up with its set-point and exceed the speed limit. The mean lies one
tick behind the newest plan; a moving target is therefore planned one tick ahead.
"""

import math

import numpy as np

from lerobot_robot_yam.control.laws.coordinate_step import closing_speed, move, step_to

_PERIOD_RANGE_S = (1 / 400, 0.1)  # a streaming caller's periods; the minimum is below 1/250, since ticks vary
_PERIOD_GAIN = 0.2  # smoothing factor of the measured caller period
_STREAM_GAP = 1.5  # caller periods without a target after which the stream counts as ended
_BORNE_OUT_RAD = 0.01  # tolerance within which a target agrees with the extrapolated previous one, rad or strokes
_TRACK_S = 0.02  # time in which a tracking set-point closes a gap: five ticks; less would pass target noise
_ACCELERATION_S = 0.02  # time constant of the measured acceleration of a tracked target
_TURNS_S = 0.3  # time in which a target's greatest acceleration is forgotten: the way from turn to turn at 2 Hz
_WEIGHTS = np.array([0.25, 0.5, 0.25])  # weights of the last three plans


class SetPoint:
    """Speed- and acceleration-limited set-point with n coordinates.

    Args:
        speed_limit: (n,) maximum |dq*|, unit/s.
        acceleration_limit: (n,) maximum |d dq*/dt|, unit/s².
        lower, upper: (n,) range of the set-point; a set-point seeded outside the range only moves inwards.
        end_deceleration: (n,) maximum deceleration at the ends of the range, unit/s².

    Attributes:
        q, dq: (n,) position and speed of the newest plan.
        target: (n,) position to which the set-point moves.
    """

    def __init__(
        self,
        speed_limit: np.ndarray,
        acceleration_limit: np.ndarray,
        lower: np.ndarray,
        upper: np.ndarray,
        end_deceleration: np.ndarray,
    ):
        n = len(speed_limit)
        self._limits = np.array((speed_limit, acceleration_limit, end_deceleration, lower, upper), dtype=float)
        self.speed_limit, self.acceleration_limit = self._limits[0], self._limits[1]
        self._lower, self._upper = self._limits[3], self._limits[4]
        self._plans = np.zeros((3, 2, n))  # q and dq of this tick and of the two previous ticks
        self.q: np.ndarray = self._plans[0, 0]
        self.dq: np.ndarray = self._plans[0, 1]
        self._asked: np.ndarray | None = None  # value of `asked`; None: not yet computed for the present plans
        self._rests = False  # whether the set-point rests at its target
        self._took_s = (math.inf, math.inf)  # lengths of this tick and of the previous tick, s
        self.target: np.ndarray = np.zeros(n)
        self._target_velocity: np.ndarray = np.zeros(n)
        self._none = np.zeros(n)
        self._target_ddq = self._most_ddq = self._none  # measured acceleration of a tracked target; its maximum of late
        self._velocity_age_s = 0.0  # age of a tracked target's speed
        self._target_at = -math.inf
        self._arrive_at = -math.inf
        self._brakes = False  # whether the set-point brakes: seeking a target that each `stop` renews, it never would
        self._tracks = False  # whether the target has a known speed, so that the set-point follows without lag
        self._streams = False  # whether a caller sends the targets, at its own rate
        self._told: tuple[np.ndarray, np.ndarray, float] | None = None  # previous target, its speed and its time
        self._period = 1 / 30

    def seed(self, q: np.ndarray) -> None:
        """Restart all coordinates, at rest, from the measured position `q` (n,)."""
        self._change()
        self._plans[:, 0], self._plans[:, 1] = q, 0.0
        self._rests, self._brakes = True, False
        self.target[:] = q
        self._target_velocity[:] = 0.0
        self._target_at = self._arrive_at = -math.inf
        self._tracks = self._streams = False
        self._told = None

    def seed_first(self, q: np.ndarray) -> None:
        """Restart the first m coordinates, at rest, from `q` (m,); the other coordinates keep moving."""
        m = len(q)
        self._change()
        self._plans[:, 0, :m], self._plans[:, 1, :m] = q, 0.0
        self.target[:m], self._target_velocity[:m] = q, 0.0

    def reseed(self, index: int, value: float) -> None:
        """Restart one coordinate, at rest, from its measured value; the target becomes that value, too."""
        self.fall_back(index, value)
        self.target[index], self._target_velocity[index] = value, 0.0

    def fall_back(self, index: int, value: float) -> None:
        """Restart one coordinate, at rest, from its measured value; its target stays."""
        self._change()
        self._plans[:, 0, index], self._plans[:, 1, index] = value, 0.0

    def shift(self, index: int, value: float) -> None:
        """Move one coordinate to `value` without changing its speed; its target stays."""
        self._change()
        self._plans[:, 0, index] = value

    def limit_speed(self, limit: np.ndarray) -> None:
        """Set the maximum speed of the first m coordinates, (m,) unit/s."""
        self.speed_limit[: len(limit)] = limit

    def limit_acceleration(self, limit: np.ndarray) -> None:
        """Set the maximum acceleration of the first m coordinates, (m,) unit/s²."""
        self.acceleration_limit[: len(limit)] = limit

    def move_at(self, dq: np.ndarray) -> None:
        """Set the speed of the first m coordinates to dq (m,), clamped to their speed limits."""
        m = len(dq)
        self._change()
        self.dq[:m] = np.minimum(np.maximum(dq, -self.speed_limit[:m]), self.speed_limit[:m])

    def set_target(
        self, target: np.ndarray, now: float, velocity: np.ndarray | None = None, age_s: float = 0.0
    ) -> None:
        """Set a new target (n,), to be reached within about one caller period if the limits allow this.

        `velocity` (n,) is the target's own speed; None: estimated from the difference to the previous target. A target
        that agrees with the motion of the previous target counts as `age_s` old, is extrapolated until the next target
        is due, and is followed without lag.
        """
        gap = now - self._target_at
        low, high = _PERIOD_RANGE_S
        own = np.zeros_like(self.q)
        if low <= gap <= high and self._streams:
            self._period += _PERIOD_GAIN * (gap - self._period)
            own = (target - self.target) / self._period
        self._streams, at_s = True, now - age_s
        borne_out = velocity is not None and gap <= high and self._borne_out(target, at_s)
        self._follow(target, own if velocity is None else velocity, now)
        self._told = None if velocity is None else (target.copy(), self._target_velocity, at_s)
        if borne_out:
            self._tracks = True
            self._move_on(age_s)
        else:
            self._arrive_at = now + self._period

    def _borne_out(self, target: np.ndarray, at_s: float) -> bool:
        """Return whether a target at time `at_s` agrees with the previous target, extrapolated at its speed."""
        if self._told is None:
            return False
        before, velocity, before_s = self._told
        return bool(np.abs(target - before - velocity * (at_s - before_s)).max() <= _BORNE_OUT_RAD)

    def track(self, target: np.ndarray, velocity: np.ndarray, now: float, age_s: float = 0.0) -> None:
        """Set a target (n,) with its speed (n,) of `age_s` ago, given at every tick, to be followed without lag."""
        before, since = self._target_velocity, now - self._target_at
        ddq, most = self._target_ddq, self._most_ddq
        told_each_tick = self._tracks and not self._streams and 0.0 < since <= _PERIOD_RANGE_S[1]
        self._follow(target, velocity, now)
        if told_each_tick:
            per_s = 1.0 / (since + _ACCELERATION_S)
            self._target_ddq = (1.0 - per_s * since) * ddq + per_s * (self._target_velocity - before)
            self._most_ddq = np.maximum(np.abs(self._target_ddq), max(1.0 - since / _TURNS_S, 0.0) * most)
        self._tracks, self._streams, self._told, self._velocity_age_s = True, False, None, age_s

    def _follow(self, target: np.ndarray, velocity: np.ndarray, now: float) -> None:
        self._rests = self._brakes = False
        # Extrapolating faster than the speed limit would lead the set-point away from the target.
        most = self.speed_limit
        self._target_velocity = np.minimum(np.maximum(velocity, -most), most)
        self.target = np.minimum(np.maximum(target, self._lower), self._upper)
        self._target_ddq = self._most_ddq = self._none
        self._target_at, self._arrive_at, self._tracks = now, -math.inf, False

    def _move_on(self, seconds: float) -> None:
        moved = self.target + self._target_velocity * seconds
        self.target = np.minimum(np.maximum(moved, self._lower), self._upper)

    def stop(self) -> None:
        """Discard the target and brake to rest within the limits. May be called at each tick until a new target."""
        braking = self.dq * np.abs(self.dq) / (2 * self.acceleration_limit)
        self.target = np.minimum(np.maximum(self.q + braking, self._lower), self._upper)
        self._target_velocity[:] = 0.0
        self._arrive_at = -math.inf
        self._rests = self._tracks = False
        self._brakes = True

    def step(self, now: float, dt: float) -> None:
        """Plan the step for the next tick of `dt` s; see `step_to` for the law of one coordinate."""
        if dt <= 0.0:
            return
        self._took_s = dt, self._took_s[0]
        if self._rests:
            return
        if self._brakes:
            self._plan_braking(dt)
            return
        if now - self._target_at > _STREAM_GAP * self._period:
            self._target_velocity[:] = 0.0
            self._target_ddq = self._none
        if self._tracks and self._streams and now > self._target_at:
            self._move_on(dt)
        if self._tracks:
            moved = self._chase(dt)
        else:
            left = max(self._arrive_at - now, dt)
            gap = self.target + self._target_velocity * dt - self.q  # this plan is commanded one tick later
            place = gap.tolist(), self._target_velocity.tolist(), self.q.tolist(), self.dq.tolist()
            moved = [step_to(left, dt, *row) for row in zip(*place, *self._limits.tolist(), strict=True)]
        self._plan(np.array(moved).T)

    def _chase(self, dt: float) -> list[tuple[float, float]]:
        """Plan the step of each coordinate towards a target whose speed is known."""
        tau = max(_TRACK_S, dt)
        meanwhile = self._target_velocity + self._target_ddq * (self._velocity_age_s + 0.5 * dt)
        place = self.target - self.q, meanwhile, self._most_ddq, self.q, self.dq
        rows = zip(*(values.tolist() for values in place), *self._limits.tolist(), strict=True)
        return [
            move(dt, q, dq, velocity + closing_speed(gap, ddq, limits[1], tau), *limits)
            for gap, velocity, ddq, q, dq, *limits in rows
        ]

    def _plan_braking(self, dt: float) -> None:
        """Plan a step that brakes with the maximum deceleration; the set-point rests where it comes to rest."""
        slower = np.maximum(np.abs(self.dq) - self.acceleration_limit * dt, 0.0) * np.sign(self.dq)
        ahead = self.q + slower * dt
        q = np.minimum(np.maximum(ahead, np.minimum(self._lower, self.q)), np.maximum(self._upper, self.q))
        self._plan(np.array((q, np.where(q == ahead, slower, 0.0))))
        if not self.dq.any():
            self.target = q
            self._brakes = bool(self._plans[:, 1].any())  # until the mean of the plans rests, too

    def _plan(self, plan: np.ndarray) -> None:
        self._plans[1:] = self._plans[:-1]
        self._plans[0] = plan
        self._asked = None

    def hold_back(self, share: np.ndarray) -> None:
        """Replan this tick with `asked_ddq` multiplied by `share` (n,)."""
        before = self._plans[2, 1]
        dq = before + share * (self.dq - before)
        self.replan(self._plans[1, 0] + dq * self._took_s[0], dq)

    def replan(self, q: np.ndarray, dq: np.ndarray) -> None:
        """Replace this tick's plan of the first m coordinates by q and dq, (m,) each, clamped to the range."""
        m = len(q)
        self._change()
        start, lower, upper = self._plans[1, 0, :m], self._lower[:m], self._upper[:m]
        inside = np.minimum(np.maximum(q, np.minimum(lower, start)), np.maximum(upper, start))
        self.q[:m], self.dq[:m] = inside, np.where(inside == q, dq, 0.0)

    def _change(self) -> None:
        """Invalidate values computed from the plans."""
        self._asked, self._rests = None, False

    @property
    def asked(self) -> np.ndarray:
        """Commanded position and speed (2, n)."""
        if self._asked is None:
            self._asked = (_WEIGHTS @ self._plans.reshape(3, -1)).reshape(2, -1)
        return self._asked

    @property
    def asked_ddq(self) -> np.ndarray:
        """Acceleration (n,) of the commanded motion, unit/s²."""
        return (self._plans[0, 1] - self._plans[2, 1]) / sum(self._took_s)

    @property
    def arrived(self) -> bool:
        """Whether the set-point rests at its target."""
        return bool(np.all(np.abs(self.target - self.q) < 1e-4) and np.all(np.abs(self.dq) < 1e-2))
