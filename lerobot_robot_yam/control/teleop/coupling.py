"""The follower's side of direct coupling: compute a target for every tick from the leader's published state.

A caller that forwards the leader's actions permits coupling, see `permit`. The target is the leader's action,
extrapolated with its speed to the present. A gap e to the follower's set-point is closed smoothly, so that the start of
coupling causes no jump:

    target = action + e,  ë = −2 ω ė − ω² e
"""

import logging
import math

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.teleop.peer_block import PeerBlock
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import NOT_LED, Led, coupling_number
from lerobot_robot_yam.system.few_values import largest

logger = logging.getLogger(__name__)

_FIELDS = ("mode", "action", "action_dq", "action_stamp_s", "presses")
_LEADS = (Mode.FLOAT, Mode.HOLD, Mode.TRACK)
_AGE_MOST_S = 0.03  # maximum age of a leader's sample: seven ticks
_AHEAD_S = 0.0033  # time from the decision to the middle of the tick in which the motors obey the command
_JOIN_PER_S = 6.0  # maximum ω: a gap shrinks to a fiftieth within 1 s
_JOIN_SPEED = 1.0  # closing speed of a wide gap, 1/s; rises to e/2 times this speed while ω grows
_JOINED = 1e-6  # gap below which the gap counts as closed


class Coupling:
    """Coupling of one follower with n motors to its leader. Advance once per tick.

    Attributes:
        active: whether coupling is permitted, and `advance` must be called at this tick.
        permitted_s: time of the last permission, s.
        number: `coupling_number` of the leader followed at this tick; 0: none.
        target, velocity: (n,) target of this tick, and its speed of `velocity_age_s` ago.
        held_back: whether max_relative_target limits the target.
    """

    def __init__(self, hardware: ResolvedArm):
        self._hardware = hardware
        self._relative = hardware.config.max_relative_target
        self._leader: PeerBlock | None = None
        self.active, self.permitted_s = False, -math.inf
        self._led = NOT_LED
        self._gap: np.ndarray = np.zeros(hardware.n)
        self._gap_rate: np.ndarray = np.zeros(hardware.n)
        self._apart = False  # whether the gap is still open
        self._before_s = -math.inf
        self._told = False
        self.held_back = False
        self.number = 0
        self.target: np.ndarray = np.zeros(hardware.n)
        self.velocity: np.ndarray = np.zeros(hardware.n)
        self.velocity_age_s = 0.0

    def permit(self, led: Led, at_s: float) -> None:
        """Permit coupling to a leader, at time at_s, until `end`; if `led` names a button, from its next press on."""
        self._led = led
        if self._leader is None or self._leader.key != led.leader:
            self.end()
            if self._leader is not None:
                self._leader.close()
            self._leader = PeerBlock(led.leader, _FIELDS)
            self._told = False
        self.active, self.permitted_s = True, at_s

    def end(self) -> None:
        """End the coupling and its permission at once: another source moves the arm, or the arm holds."""
        self.active, self.number = False, 0

    def give_way(self) -> None:
        """Leave this tick to the caller's target; the permission stays valid."""
        self.number = 0

    def can_follow(self, now: float) -> bool:
        """Return whether a permitted leader has fresh targets, which then replace the caller's targets."""
        return self.active and self._action(now) is not None

    def advance(self, now: float, asked: tuple[np.ndarray, np.ndarray], measured: np.ndarray) -> bool:
        """Compute the target of this tick; return False if the leader has none, or is stale.

        Args:
            now: time, s.
            asked: the set-point's position and speed, (n,) each.
            measured: (n,) measured position.
        """
        dt, self._before_s = min(now - self._before_s, 0.02), now
        action = self._action(now)
        if action is None:
            self.number = 0
            return False
        self._follow(*action, asked, dt)
        self._limit(measured)
        return True

    def _action(self, now: float) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the leader's action, extrapolated to the present, and its speed; None if unknown or stale."""
        leader, n = self._leader, self._hardware.n
        if leader is None or not leader.look(now) or leader.value("mode") not in _LEADS:
            return None
        button = self._led.button
        if button and leader.slots("presses", 2)[button - 1] <= self._led.presses:
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
        speed, self.velocity_age_s = np.array(dq), age_s + _AHEAD_S
        return np.array(q) + speed * self.velocity_age_s, speed

    def _follow(self, q: np.ndarray, dq: np.ndarray, asked: tuple[np.ndarray, np.ndarray], dt: float) -> None:
        if not self.number:  # the follower joins
            before, speed = asked
            self._gap, self._gap_rate, self._apart = before - q, speed - dq, True
            assert self._leader is not None
            self.number = coupling_number(self._leader.key)
        elif self._apart:
            farthest = largest(self._gap)
            rate = min(_JOIN_PER_S, math.e * _JOIN_SPEED / max(farthest, 1e-9))
            self._gap_rate = self._gap_rate - (2.0 * rate * self._gap_rate + rate * rate * self._gap) * dt
            self._gap = self._gap + self._gap_rate * dt
            if farthest < _JOINED:
                self._gap[:] = self._gap_rate[:] = 0.0
                self._apart = False
        self.target, self.velocity = q + self._gap, dq + self._gap_rate

    def _limit(self, measured: np.ndarray) -> None:
        """Clamp the target like a caller's target: to the joint limits, then by max_relative_target."""
        lower, upper = self._hardware.lower, self._hardware.upper
        self.target = np.minimum(np.maximum(self.target, lower), upper)
        if self._relative is not None:
            low, high = np.maximum(measured - self._relative, lower), np.maximum(measured + self._relative, lower)
            near = np.minimum(np.maximum(self.target, low), np.minimum(high, upper))
            self.held_back, self.target = not np.array_equal(near, self.target), near

    def close(self) -> None:
        """Close the leader's block. Idempotent."""
        leader, self._leader = self._leader, None
        if leader is not None:
            leader.close()
