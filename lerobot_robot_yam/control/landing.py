"""Landing: bring the arm down under control to where cutting torque moves nothing.

    fold    straight joint line to the folded pose with the wrist raised, at LANDING_SPEED at most; an arm that lies
            already stays. Where something is in its way, it goes round, over the top: wrist up and elbow open until
            the forearm is level at least, upper arm back, forearm down
    lower   the wrist down to its resting place, stopping at contact
    fade    stiffness and feed-forward to nothing under full damping; whatever is still unsupported sinks slowly
    still   wait until nothing moves; only then may torque be cut

If both ways are barred the arm holds, says so and tries again. The third time it sinks slowly onto what is below it.
An arm without one of the motors that carry it may never get there, since a limp wrist stands in its way. It sinks onto
what it has met on its way down. It also sinks, and does not fade, if one is out at the end of `lower`: nobody knows
where its joint is then. A motor that is not heard may obey: its set-point is lowered, as its weight pulls by the model,
to the end of its range or to where it hangs. Only then does its stiffness fade.

An arm whose model is wrong hangs off its set-point. A torque that a wrong load or factor explains is learnt then; any
other torque means an obstacle. An unknown load makes the soft wrist sag. The wrist is lowered next, so that is no
obstacle.

An arm whose base is tilted, or whose resting pose is configured, does not lie there. From there it sinks to where it
hangs or lies, and torque is cut when nothing moves any more.
"""

import logging
from enum import Enum, auto

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.laws.set_point import SetPoint

logger = logging.getLogger(__name__)

LANDING_SPEED_RAD_S = 0.6  # no joint lands faster
_COMMANDED_RAD_S = 0.52  # arms answer with up to 12 % more where their weight is overcompensated
_RAMP_S = 0.12  # to that speed; a quicker start overshoots
_WRIST_LIFT_RAD = 0.35  # how far above its resting place the wrist stays while the arm folds
_SOFT_RAD = 0.3  # from here on the fold slows down: some joints end on their mechanical stops
_SOFT_RAD_S2 = 5.0
_OPEN_RAD = 1.2  # elbow with which the tool is highest while the upper arm lies
_AT_POSE_RAD = 0.06
_STUCK_RAD = 0.25  # set-point this far ahead of the arm: something is in the way
_CONTACT_RAD = 0.12
_SAG_NM = 5.0  # of the wrist's stiffness: 2 kg at 0.25 m. More torque means an obstacle, not a load
_STUCK_S = 0.5
_RETRY_S = 3.0
_LEARN_S = 2.0
_TRIES = 3  # ways that are barred; then it sinks
_FADE_S = 0.15
_SINK_S = 1.5  # the same where it does not lie yet, if it stays below
_SINK_RAD_S = 0.3
_LOOSE = 0.1  # of the damping at last: what slides hardly with all of it would slide on without
_STIFFEN_S = 0.3  # from nothing to all of it, when it sinks faster
_STILL_RAD_S = 0.03
_STILL_S = 0.06
_SUNK_S = 1.0
_CREEP_RAD = 0.02
_FELL_BACK_RAD = 0.02  # of a set-point in one tick: its joint was struck and caught


class Phase(Enum):
    """Where a landing is."""

    FOLD = auto()
    LOWER = auto()
    FADE = auto()
    SINK = auto()
    LANDED = auto()
    OBSTRUCTED = auto()


class Landing:
    """One landing of the arm joints (n,).

    Args:
        hardware: the arm. Where it does not lie at its resting pose, it sinks from there to where it hangs or lies.
        q: (n,) rad, where the arm is.
        setpoint: the arm's set-point; its limits are lowered for good.
        now: monotonic s.
    """

    def __init__(self, hardware: ResolvedArm, q: np.ndarray, setpoint: SetPoint, now: float):
        self._arm, self._roles, self._setpoint = hardware.name, hardware.folding, setpoint
        self._n = n = hardware.joints
        self._rest, kp, lies_at_rest = hardware.rest_q.copy(), hardware.kp[:n], hardware.lies_at_rest
        roles = self._roles
        if roles.base is not None and lies_at_rest:
            self._rest[roles.base] = q[roles.base]  # the base may stay turned: it carries no weight
        self._fold = self._rest.copy()
        if roles.wrist is not None:
            self._up = float(np.copysign(1.0, -self._rest[roles.wrist]))  # which way the wrist is raised
            self._fold[roles.wrist] += self._up * _WRIST_LIFT_RAD
            self._sag_rad = _SAG_NM / max(float(kp[roles.wrist]), 1.0)
        lies = bool(np.abs(q - self._rest).max() < _AT_POSE_RAD)
        self.phase = Phase.LOWER if lies else Phase.FOLD
        self._since = now
        self._speed = np.zeros(n)
        self._way: list[np.ndarray] = []  # poses still to come of the fold
        self._goes_round = False
        self._barred_times = 0
        self.learns = self._may_learn = False
        self._lies_at_rest = lies_at_rest
        self._sinks = not lies_at_rest  # rather than to be let go at once, where it may not lie yet
        self._out = np.ones(n, dtype=bool)  # since this move began
        self._answers = ~self._out
        self._stuck_since: float | None = None
        self._still_since, self._still_q = now, q.copy()
        self._before = now
        self.share = self.damping = 1.0
        self._shares: np.ndarray = np.ones(n)  # of each joint
        self._lowers = ~self._out  # with its stiffness, unheard
        self._lower_rad, self._upper_rad = hardware.lower[:n], hardware.upper[:n]
        self._lag_rad = _SAG_NM / np.maximum(kp, 1.0)
        self._begin_move(self._rest if lies else self._fold, now)

    def _begin_move(self, goal: np.ndarray, now: float) -> None:
        """Straight line: every joint arrives at the same time."""
        self._since = now
        self._out[:] = True
        gap = np.abs(goal - self._setpoint.q[: self._n])
        self._left = gap
        longest = max(float(gap.max()), 1e-3)
        self._speed = np.maximum(_COMMANDED_RAD_S * gap / longest, 0.05)
        self._start(now)
        target = self._setpoint.q.copy()
        target[: self._n] = goal
        self._setpoint.set_target(target, now)

    @property
    def fade(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Shares (n,) of stiffness with feed-forward, and of damping, while the arm lies or sinks, else None.

        A motor that does not answer gets no stiffness back: if it obeys, it has left its set-point unseen.
        """
        if self.phase not in (Phase.FADE, Phase.SINK):
            return None
        return self._shares, np.where(self._answers, self.damping, 1.0)

    @property
    def sunk(self) -> np.ndarray:
        """(n,) bool, joints that have lost stiffness while their motors did not answer: nobody knows where they are."""
        return ~self._answers & (self._shares < 1.0)

    def advance(
        self,
        q: np.ndarray,
        dq: np.ndarray,
        usable: np.ndarray,
        now: float,
        explained: bool = True,
        pulls: np.ndarray | float = 0.0,
    ) -> None:
        """One tick; sets `phase`, `share` (of stiffness and feed-forward), `damping` (its share), `learns` (what the
        model misses), and the set-point.

        Args:
            q, dq: (n,) rad, rad/s.
            usable: (n,) bool, joints whose motors answer; the others cannot be waited for.
            now: s.
            explained: a wrong model can be why the arm is not where its set-point is.
            pulls: (n,) the way, -1 or 1, in which its weight pulls a joint that is not heard and may obey; else 0.
        """
        left = np.abs(self._setpoint.target[: self._n] - self._setpoint.q[: self._n])
        if self.phase in (Phase.FOLD, Phase.LOWER) and (left > self._left + _FELL_BACK_RAD).any():
            self._begin_move(self._setpoint.target[: self._n].copy(), now)  # or that joint would crawl
        self._left = left
        self._start(now)
        dt, self._before = now - self._before, now
        self._out &= ~usable
        self._answers = usable
        error = np.where(usable, np.abs(self._setpoint.q[: self._n] - q), 0.0)
        if self.phase is Phase.FOLD:
            way = self._setpoint.target[: self._n] - self._setpoint.q[: self._n]  # a base beyond its limit comes inside
            if np.abs(way).max() < _SOFT_RAD:
                self._setpoint.limit_acceleration(np.full(self._n, _SOFT_RAD_S2))
            wrist = self._roles.wrist
            if wrist is not None and 0.0 < self._up * (self._setpoint.q[wrist] - q[wrist]) < self._sag_rad:
                error[wrist] = 0.0
            at_pose = error.max() < _AT_POSE_RAD
            if self._way and self._setpoint.arrived and error.max() < _STUCK_RAD:
                self._begin_move(self._way.pop(0), now)
            elif at_pose and self._setpoint.arrived:
                self._lower(now)
            elif self._setpoint.arrived and explained and error.max() < _STUCK_RAD:
                self._may_learn = True
                if self._stuck(True, now, _LEARN_S):
                    self._sinks = True
                    self._lower(now)
            elif self._stuck(error.max() > _STUCK_RAD or self._setpoint.arrived, now):
                self._give_way(self._pressed_less(self._setpoint.q[: self._n], q), usable)
                self._barred(f"joint_{int(error.argmax()) + 1} is obstructed or carries too much", now)
        elif self.phase is Phase.OBSTRUCTED:
            if now - self._since > _RETRY_S:
                self._goes_round, self._may_learn = False, True
                self._go([self._fold], now)
        elif self.phase is Phase.LOWER:
            if self._setpoint.arrived or self._stuck(error.max() > _CONTACT_RAD, now, patience_s=0.1):
                self._give_way(q, usable)
                self._enter(Phase.SINK if self._sinks or self._carriers(~usable) else Phase.FADE, now)
        elif self.phase is Phase.FADE:
            self.share = max(0.0, self.share - dt / _FADE_S)
            self._end_when_still(q, dq, usable, now, _STILL_S, self.share == 0.0)
        elif self.phase is Phase.SINK:
            before, most = self._setpoint.q[: self._n].copy(), _SINK_RAD_S * dt
            trail = np.clip(q, before - most, before + most)
            self._give_way(self._pressed_less(trail, q), usable)
            lowered = before + most * pulls
            inside = (lowered >= self._lower_rad) & (lowered <= self._upper_rad)
            self._lowers = inside & (lowered != before) & (self._shares > 0.0) & ~usable & self._sinks
            self._give_way(lowered, self._lowers)
            slow = np.abs(np.where(usable, dq, 0.0)).max() < _SINK_RAD_S
            if not slow:
                self.share, self.damping = min(self.share + dt / _STIFFEN_S, 1.0), 1.0
            elif self.share > 0.0:
                self.share = max(self.share - dt / _SINK_S, 0.0)
            else:
                self.damping = max(self.damping - dt / _SINK_S, _LOOSE)
            loose = self.share == 0.0 and self.damping == _LOOSE and not self._shares[~usable].any()
            self._end_when_still(q, dq, usable, now, _SUNK_S, loose)

        self.learns = self._may_learn and explained and self.fade is None
        if self.fade is not None:
            fade_s = _FADE_S if self.phase is Phase.FADE else _SINK_S
            fading = np.where(self._lowers, self._shares, np.maximum(self._shares - dt / fade_s, 0.0))
            self._shares = np.where(usable, self.share, fading)

    def _end_when_still(
        self, q: np.ndarray, dq: np.ndarray, usable: np.ndarray, now: float, still_s: float, loose: bool
    ) -> None:
        moving = np.abs(np.where(usable, dq, 0.0)).max() > _STILL_RAD_S
        if not loose or moving or np.abs(q - self._still_q).max() > _CREEP_RAD:
            self._still_since, self._still_q = now, q.copy()
        elif now - self._still_since > still_s:
            self._enter(Phase.LANDED, now)

    def _barred(self, reason: str, now: float) -> None:
        """Something is in the way: go round; hold where that is barred, too, or sink where a motor is out."""
        out, over = self._carriers(self._out), self._over_the_top() if self._lies_at_rest else []
        if over and not self._goes_round:
            self._goes_round = True
            logger.warning("%s: on its way down %s; it goes round, over the top", self._arm, reason)
            self._go(over, now)
        elif out and self._way:  # an obstacle to the way up carries nothing
            self._go([self._fold], now)
        elif out:
            logger.warning("%s: %s, and %s is out; it sinks where it is", self._arm, reason, ", ".join(out))
            self._sink(now)
        elif (barred := self._barred_times + 1) < _TRIES:
            self._barred_times = barred
            self._enter(Phase.OBSTRUCTED, now)
            text = "%s: cannot land, %s; holding. Free the way or take the load, and keep clear: I try again"
            logger.error(text, self._arm, reason)
        else:
            logger.error("%s: cannot land, %s; it sinks slowly where it is", self._arm, reason)
            self._sink(now)

    def _sink(self, now: float) -> None:
        self._sinks = True
        self._enter(Phase.SINK, now)

    def _carriers(self, out: np.ndarray) -> list[str]:
        """Joints that carry, and whose motors are out, (n,) bool: limp, or not heard."""
        base, first, _, last = self._roles
        if first is None or last is None:  # any of them may
            carriers = [joint for joint in range(self._n) if joint != base]
        else:
            carriers = list(range(first, last + 1))
        return [f"joint_{joint + 1}" for joint in carriers if out[joint]]

    def _over_the_top(self) -> list[np.ndarray]:
        """Poses on the way over an obstacle; empty for an arm without shoulder or elbow."""
        _, shoulder, elbow, wrist = self._roles
        if shoulder is None or elbow is None:
            return []
        level = self._setpoint.q[: self._n].copy()
        if wrist is not None:
            level[wrist] = self._fold[wrist]
        open_rad = max(_OPEN_RAD, level[shoulder] - self._rest[shoulder])
        level[elbow] = max(level[elbow], self._rest[elbow] + open_rad)
        back = level.copy()
        back[shoulder], back[elbow] = self._rest[shoulder], self._rest[elbow] + _OPEN_RAD
        return [level, back, self._fold]

    def _lower(self, now: float) -> None:
        self._may_learn = False
        self._enter(Phase.LOWER, now)
        self._begin_move(self._rest, now)

    def _go(self, way: list[np.ndarray], now: float) -> None:
        self._enter(Phase.FOLD, now)
        first, *self._way = way
        self._begin_move(first, now)

    def _start(self, now: float) -> None:
        self._setpoint.limit_speed(self._speed * np.clip((now - self._since) / _RAMP_S, 0.1, 1.0))

    def _enter(self, phase: Phase, now: float) -> None:
        self.phase, self._since, self._stuck_since = phase, now, None

    def _stuck(self, condition: bool, now: float, patience_s: float = _STUCK_S) -> bool:
        if not condition:
            self._stuck_since = None
            return False
        if self._stuck_since is None:
            self._stuck_since = now
        return now - self._stuck_since > patience_s

    def _pressed_less(self, setpoint: np.ndarray, q: np.ndarray) -> np.ndarray:
        """The set-point where its pull may be a load that the model does not know, and is not much if it is not."""
        least: np.ndarray = np.minimum(np.maximum(setpoint, q - self._lag_rad), q + self._lag_rad)
        return least

    def _give_way(self, q: np.ndarray, usable: np.ndarray) -> None:
        """Move the set-point to q, at rest, for joints whose place is known."""
        seed = self._setpoint.q.copy()
        seed[: self._n] = np.where(usable, q, seed[: self._n])
        self._setpoint.seed(seed)
