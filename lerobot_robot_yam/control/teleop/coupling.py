"""The follower's side of direct coupling: targets of every tick from its leader's state.

While the caller passes the leader's action on, it permits that, see `permit`. The target is the leader's action, as
it is by now if it went on with its speed. A gap to where the follower is asked to be is closed smoothly, since neither
begin nor end of coupling may move the arm at once:

    target = action + e,  ë = −2 ω ė − ω² e          while it follows
    target' = −target' / τ                           when permission or fresh data end: it comes to rest
"""

import logging
import math

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.teleop.peer_block import PeerBlock
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import coupling_number
from lerobot_robot_yam.system.few_values import largest

logger = logging.getLogger(__name__)

_FIELDS = ("mode", "action", "action_dq", "action_stamp_s")
_LEADS = (Mode.FLOAT, Mode.HOLD, Mode.TRACK)
_AGE_MOST_S = 0.03  # of a leader's sample: seven ticks
_AHEAD_S = 0.0033  # from the decision to the middle of the tick in which the motors obey it
_JOIN_PER_S = 6.0  # ω: a gap is closed to a fiftieth within 1 s
_JOIN_SPEED = 1.0  # 1/s, at which a wide gap is closed; up to e/2 times that, since ω grows as it closes
_REST_S = 0.15  # τ
_AT_REST = 1e-3  # 1/s
_JOINED = 1e-6


class Coupling:
    """Couples one follower, n motors, to its leader. Ask once per tick.

    Attributes:
        number: `coupling_number` of the leader that is followed at this tick; 0: none.
        target, velocity: (n,) of this tick.
        held_back: max_relative_target holds the target back.
    """

    def __init__(self, hardware: ResolvedArm):
        self._hardware = hardware
        self._relative = hardware.config.max_relative_target
        self._leader: PeerBlock | None = None
        self._until_s = -math.inf
        self._moves = False  # it follows, or comes to rest
        self._gap: np.ndarray = np.zeros(hardware.n)
        self._gap_rate: np.ndarray = np.zeros(hardware.n)
        self._apart = False  # the gap is not closed
        self._before_s = -math.inf
        self._told = False
        self.held_back = False
        self.number = 0
        self.target: np.ndarray = np.zeros(hardware.n)
        self.velocity: np.ndarray = np.zeros(hardware.n)

    def permit(self, leader: str, until_s: float) -> None:
        """Allow to follow the leader with this channel key until then."""
        if self._leader is None or self._leader.key != leader:
            self.end()
            if self._leader is not None:
                self._leader.close()
            self._leader = PeerBlock(leader, _FIELDS)
            self._told = False
        self._until_s = until_s

    def end(self) -> None:
        """Follow no more, from this tick on: something else moves the arm, or holds it."""
        self._until_s = -math.inf
        self._moves, self.number = False, 0

    def give_way(self) -> None:
        """The caller gives a target of this tick; the permission stays."""
        self._moves, self.number = False, 0

    def can_follow(self, now: float) -> bool:
        """Whether the leader tells its targets at present, and following it is allowed: the caller's need not count."""
        return now <= self._until_s and self._action(now) is not None

    @property
    def active(self) -> bool:
        """Whether `advance` has to be asked."""
        return self._moves or self._until_s > -math.inf

    def advance(self, now: float, asked: tuple[np.ndarray, np.ndarray], measured: np.ndarray) -> bool:
        """Find the target of this tick; False when there is none.

        Args:
            now: s.
            asked: position and speed (n,) of the set-point.
            measured: (n,).
        """
        dt, self._before_s = min(now - self._before_s, 0.02), now
        action = self._action(now) if now <= self._until_s else None
        if action is not None:
            self._follow(*action, asked, dt)
        elif self._moves:
            self._come_to_rest(dt)
        if now > self._until_s:
            self._until_s = -math.inf
        if not self._moves:
            return False
        self._limit(measured)
        return True

    def _action(self, now: float) -> tuple[np.ndarray, np.ndarray] | None:
        """The leader's action and its speed at present, None when it does not tell."""
        leader, n = self._leader, self._hardware.n
        if leader is None or not leader.look(now) or leader.value("mode") not in _LEADS:
            return None
        told = leader.slots("action", n + 1)
        q, dq = told[:n], leader.slots("action_dq", n)
        age_s = now - leader.value("action_stamp_s")
        if not -_AGE_MOST_S < age_s < _AGE_MOST_S or not all(map(math.isfinite, (*q, *dq))):
            return None
        if not math.isnan(told[n]):
            if not self._told:
                what = "%s: %s leads an arm with more motors than this one; it follows at the caller's rate"
                logger.warning(what, self._hardware.name, leader.key)
                self._told = True
            return None
        speed = np.array(dq)
        return np.array(q) + speed * (age_s + _AHEAD_S), speed

    def _follow(self, q: np.ndarray, dq: np.ndarray, asked: tuple[np.ndarray, np.ndarray], dt: float) -> None:
        if not self.number:  # it joins
            before, speed = (self.target, self.velocity) if self._moves else asked
            self._gap, self._gap_rate, self._apart = before - q, speed - dq, True
            assert self._leader is not None
            self._moves, self.number = True, coupling_number(self._leader.key)
        elif self._apart:
            farthest = largest(self._gap)
            rate = min(_JOIN_PER_S, math.e * _JOIN_SPEED / max(farthest, 1e-9))
            self._gap_rate = self._gap_rate - (2.0 * rate * self._gap_rate + rate * rate * self._gap) * dt
            self._gap = self._gap + self._gap_rate * dt
            if farthest < _JOINED:
                self._gap[:] = self._gap_rate[:] = 0.0
                self._apart = False
        self.target, self.velocity = q + self._gap, dq + self._gap_rate

    def _come_to_rest(self, dt: float) -> None:
        self.number = 0
        self.velocity = self.velocity * math.exp(-dt / _REST_S)
        self.target = self.target + self.velocity * dt
        self._moves = largest(self.velocity) > _AT_REST

    def _limit(self, measured: np.ndarray) -> None:
        """As the caller's targets are: joint limits, then max_relative_target."""
        lower, upper = self._hardware.lower, self._hardware.upper
        self.target = np.minimum(np.maximum(self.target, lower), upper)
        if self._relative is not None:
            low, high = np.maximum(measured - self._relative, lower), np.maximum(measured + self._relative, lower)
            near = np.minimum(np.maximum(self.target, low), np.minimum(high, upper))
            self.held_back, self.target = not np.array_equal(near, self.target), near

    def close(self) -> None:
        """Let go of the leader's block. Idempotent."""
        leader, self._leader = self._leader, None
        if leader is not None:
            leader.close()
