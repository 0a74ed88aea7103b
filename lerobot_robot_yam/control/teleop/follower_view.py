"""A leader's view of its follower: the newest state published by the follower's control loop."""

import logging
import math

import numpy as np

from lerobot_robot_yam.control.teleop.peer_block import PeerBlock
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import coupling_number
from lerobot_robot_yam.system.few_values import largest

logger = logging.getLogger(__name__)

_FIELDS = ("mode", "joints", "motors", "q", "dq", "setpoint", "motor_stamp_s", "coupled_to")
_NEAR_RAD = 0.3  # distance between set-point and the leader's target within which the follower counts as following
_AGE_MOST_S = 0.03
_LOST_S = 0.1  # delay of a message, s: after an emergency stop two loops do not resume in the same tick
_AWAITED_S = 30.0  # time to wait for a follower before a warning, s: LeRobot commands with cameras connect slowly


class FollowerView:
    """View of one follower for its leader. Update once per tick.

    Args:
        leader: name of the leader, for messages.
        key, own_key: channel keys of the follower and of the leader.
        joints, motors: required numbers of the follower's joints and motors.

    Attributes:
        there: whether the follower's state is fresh and in HOLD or TRACK.
        led_by_another: whether the follower tracks targets but is not coupled to this leader.
        coupled: whether the follower takes this leader's targets at loop rate, according to its newest state.
        follows: whether the follower is coupled, or receives this leader's targets from a caller, see `judge`.
        q, dq, setpoint: (motors,) follower's state while `there`.
    """

    def __init__(self, leader: str, key: str, own_key: str, joints: int, motors: int):
        self._leader, self._key, self._number = leader, key, coupling_number(own_key)
        self._shape = joints, motors
        self._block = PeerBlock(key, _FIELDS)
        self._joints, self._motors = joints, motors
        self._since_s: float | None = None  # time since which the follower is awaited
        self._told: str | None = ""  # problem logged last; None: no problem
        self.there = self.coupled = self.follows = self.led_by_another = False
        self.q, self.dq, self.setpoint = np.zeros(motors), np.zeros(motors), np.zeros(motors)
        self._stamps_s, self._stamp_s = np.zeros(joints), -math.inf

    def look(self, now: float) -> bool:
        """Read the follower's newest state; return `there`."""
        before, block, count = self.there, self._block, self._motors
        fresh = block.look(now)
        fits = fresh and (block.value("joints"), block.value("motors")) == self._shape
        self.there = fits and block.value("mode") in (Mode.HOLD, Mode.TRACK)
        if self.there:
            values = block.slots("q", count), block.slots("dq", count), block.slots("setpoint", count)
            self._stamps_s = np.array(block.slots("motor_stamp_s", self._joints))
            self._stamp_s = min(self._stamps_s.tolist(), default=-math.inf)
            finite = math.isfinite(sum(map(sum, values)))
            self.there = finite and now - self._stamp_s < _AGE_MOST_S
            if self.there:
                self.q, self.dq, self.setpoint = np.array(values)
        self.coupled = self.there and block.value("coupled_to") == self._number
        self.led_by_another = self.there and not self.coupled and block.value("mode") == Mode.TRACK
        if not self.there:
            self.follows = False
        if self.there is not before or not self.there:
            self._tell(now, fresh and not fits)
        return self.there

    def judge(self, target: np.ndarray) -> None:
        """Set `follows`: whether the follower moves to the leader's target (motors,).

        A policy with targets near the leader's target cannot be distinguished from a caller that modifies the leader's
        actions. So `follows` may change the gate's state, but must not move the leader.
        """
        block = self._block
        self.follows = self.coupled
        if block.value("coupled_to") == 0 and block.value("mode") == Mode.TRACK:
            self.follows = largest((self.setpoint - target)[: self._joints]) < _NEAR_RAD

    def age_s(self, now: float) -> float:
        """Return the age of the oldest of the follower's samples, s."""
        return now - self._stamp_s

    def q_at(self, now: float) -> np.ndarray:
        """Return the follower's position (joints,) at time `now`, extrapolated from the newest sample, rad."""
        j = slice(self._joints)
        q: np.ndarray = self.q[j] + self.dq[j] * (now - self._stamps_s)
        return q

    def _tell(self, now: float, other: bool) -> None:
        """Log each problem once, and once that the follower is led again."""
        if self.there:
            if self._told is not None:
                logger.info("%s: leads %s", self._leader, self._key)
            self._told = self._since_s = None
            return
        if self._since_s is None:
            self._since_s = now
        if now - self._since_s < _LOST_S:
            return
        told = None
        if other:
            motors = f"{self._motors} motors, {self._joints} of them joints"
            told = f"{self._key} is another arm than its follower, which has {motors}; it is not led"
        elif math.isfinite(self._stamp_s):
            told = f"its follower {self._key} is silent, or neither holds nor tracks; it floats without force"
        elif now - self._since_s > _AWAITED_S:
            told = f"nobody drives its follower {self._key}; it floats without force"
        if told is not None and told != self._told:
            logger.warning("%s: %s", self._leader, told)
            self._told = told

    def close(self) -> None:
        """Close the block. Idempotent."""
        self._block.close()
