"""A leader's target for its follower in each state of the gate, continuous across state changes.

    HOMING, IDLE   moves home, or stays there; with a gate button, IDLE stays at the last target
    APPROACH       start + s (leader − start),  s = (1 − cos(π t / T)) / 2,  T = max(approach_s, π/2 · gap / speed)
    ENGAGED        the leader's pose
    FINE           anchor + scale (leader − leader's anchor); the gripper follows the trigger
    RECENTRE       stays at the last target; the gripper follows the trigger

While nobody forwards the targets to the follower, the ramp stays at the follower's set-point.
Without a gate the target is the leader's pose from the start, and the follower moves there at its own speed limit. The
leader's trigger sets the gripper's opening, 0 closed … 1 open, see `TriggerPickup`.
"""

import math

import numpy as np

from lerobot_robot_yam.arm.leaders.lead_config import LeadConfig
from lerobot_robot_yam.control.laws.glide import Glide
from lerobot_robot_yam.control.teleop.follower_view import FollowerView
from lerobot_robot_yam.state.modes import Gate

_ACCELERATION = 3.0  # joint acceleration limit while homing, rad/s²
_GRIPPER_ACCELERATION, _GRIPPER_SPEED = 10.0, 1.0  # gripper limits while homing: strokes/s², then strokes/s
NEAR = 0.05  # distance between trigger and gripper opening below which the trigger takes over, share of the stroke

Target = tuple[np.ndarray, np.ndarray]


class TargetRamp:
    """Target ramp of one leader-follower pair; the follower has m motors.

    Args:
        config: the leader's configuration.
        home, lower, upper: (m,) the follower's home pose and range.
    """

    def __init__(self, config: LeadConfig, home: np.ndarray, lower: np.ndarray, upper: np.ndarray):
        self._config, self._home, self._lower, self._upper = config, home, lower, upper
        self._grips = slice(-1, None) if upper[-1] == 1.0 and lower[-1] == 0.0 else slice(0, 0)
        acceleration = np.full(len(home), _ACCELERATION)
        acceleration[self._grips] = _GRIPPER_ACCELERATION
        self._acceleration = acceleration
        self._glide = Glide(acceleration)
        self._goal = home
        self._q: np.ndarray | None = None  # the last target
        self._dq = np.zeros(len(home))
        self._anchor, self._leader_anchor, self._start = home, home, home
        self._began_s, self._lasts_s = math.inf, 0.0

    def forget(self) -> None:
        """Forget the target after a stop of the arms, so that the next target starts at the follower."""
        self._q = None

    def approached(self, now: float) -> bool:
        """Return whether the planned time of the approach is over."""
        return self._config.gate == "always" or now - self._began_s >= self._lasts_s

    def enter(self, state: Gate, now: float, leader: np.ndarray, follower: FollowerView | None) -> None:
        """Enter a state of the gate at this tick. leader: (m,) joints, rad, then the trigger's opening."""
        before = leader if self._q is None else self._q
        if state in (Gate.HOMING, Gate.IDLE):
            self._glide.seed(before, self._dq)
            self._goal = self._home
            if self._config.gate == "button":  # come to rest
                self._goal = before + self._dq * np.abs(self._dq) / (2.0 * self._acceleration)
        elif state is Gate.APPROACH:
            self._begin_approach(now, leader, follower)
        elif state is Gate.FINE:
            self._anchor, self._leader_anchor = before, leader
        elif state is Gate.RECENTRE:
            self._anchor = before

    def _begin_approach(self, now: float, leader: np.ndarray, follower: FollowerView | None) -> None:
        if follower is not None:
            self._start = follower.q.copy()
            self._start[self._grips] = follower.setpoint[self._grips]  # keeps the grip force
        elif self._q is not None:
            self._start = self._q
        joints = np.delete(np.abs(leader - self._start), np.arange(len(leader))[self._grips])
        way_s = math.pi / 2.0 * float(joints.max(initial=0.0)) / self._config.approach_speed_rad_s
        self._began_s, self._lasts_s = now, max(self._config.approach_s, way_s)

    def advance(
        self, state: Gate, now: float, dt: float, leader: np.ndarray, rate: np.ndarray, follower: FollowerView | None
    ) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Compute the target (m,) and its speed (m,) at this tick; None while the start of a ramp is unknown.

        Args:
            state: present state of the gate.
            now, dt: time, and time since the last tick, s.
            leader, rate: (m,) the leader's joints and the trigger's opening, and their speeds.
            follower: view of the follower; None: the follower is absent.
        """
        direct = state is Gate.ENGAGED or (state is Gate.APPROACH and self._config.gate == "always")
        waits = follower is not None and not follower.follows
        if direct:
            q, dq = leader, rate
        elif self._q is None and follower is None:
            return None, None
        elif state is Gate.APPROACH:
            if waits or not math.isfinite(self._began_s):
                self._begin_approach(now, leader, follower)
            q, dq = self._blend(now, leader, rate)
        elif state is Gate.FINE:
            scale = self._config.fine_scale
            q, dq = self._anchor + scale * (leader - self._leader_anchor), scale * rate
            q[self._grips], dq[self._grips] = leader[self._grips], rate[self._grips]
        elif state is Gate.RECENTRE:
            q, dq = self._anchor.copy(), np.zeros(len(rate))
            q[self._grips] = leader[self._grips]
        else:
            q, dq = self._go_home(state, dt, follower if waits or self._q is None else None)
        q = np.minimum(np.maximum(q, self._lower), self._upper)
        self._q, self._dq = q, dq
        return q, dq

    def _blend(self, now: float, leader: np.ndarray, rate: np.ndarray) -> Target:
        phase = min(max(now - self._began_s, 0.0) / self._lasts_s, 1.0) if self._lasts_s > 0.0 else 1.0
        share = 0.5 - 0.5 * math.cos(math.pi * phase)
        share_rate = 0.5 * math.pi / self._lasts_s * math.sin(math.pi * phase) if phase < 1.0 else 0.0
        way = leader - self._start
        return self._start + share * way, share * rate + share_rate * way

    def _go_home(self, state: Gate, dt: float, wait_at: FollowerView | None) -> Target:
        if wait_at is not None:
            self._glide.seed(wait_at.setpoint)
            if self._config.gate == "button":
                self._goal = wait_at.setpoint.copy()
            return wait_at.setpoint.copy(), np.zeros(len(self._home))
        config = self._config
        speed = np.full(len(self._home), config.homing_speed_rad_s if state is Gate.HOMING else config.idle_speed_rad_s)
        speed[self._grips] = _GRIPPER_SPEED
        self._glide.advance(self._goal, speed, dt)
        return self._glide.q, self._glide.dq


class TriggerPickup:
    """Takeover of the gripper by a trigger, which has no motor. While another source moves the gripper, the trigger is
    ignored. Afterwards the trigger takes over once it meets or passes the opening, so that a held object stays held.
    """

    def __init__(self) -> None:
        self._left: float | None = None  # opening at which another source left the gripper
        self._before = 1.0  # the trigger's opening at the last tick
        self.opening: float | None = None  # None before the first report and the first `leave`

    def leave(self, opening: float, trigger: float) -> None:
        """Record that another source has moved the gripper to `opening`; see `advance` for `trigger`."""
        self._left = self.opening = opening
        if not math.isnan(trigger):
            self._before = 1.0 - trigger

    def advance(self, trigger: float) -> None:
        """Process one tick. trigger: 0 released … 1 squeezed; NaN while the handle is silent: the opening stays."""
        if math.isnan(trigger):
            return
        asks, before = 1.0 - trigger, self._before
        self._before = asks
        left = self._left
        if left is not None and abs(asks - left) > NEAR and (asks - left) * (before - left) > 0.0:
            return
        self._left, self.opening = None, asks
