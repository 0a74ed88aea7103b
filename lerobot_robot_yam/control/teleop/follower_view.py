"""View of a follower by its leader: the newest state that the follower's control loop publishes."""

import logging
import math

import numpy as np

from lerobot_robot_yam.control.teleop.peer_block import PeerBlock
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import coupling_number
from lerobot_robot_yam.system.few_values import largest

logger = logging.getLogger(__name__)

_FIELDS = ("mode", "joints", "motors", "q", "dq", "setpoint", "motor_stamp_s", "coupled_to")
_NEAR_RAD = 0.3  # distance within which a set-point is on its way to the leader's target, whoever sent it
_AGE_MOST_S = 0.03
_LOST_S = 0.1  # time before a message: two loops do not resume in the same tick after an emergency stop
_AWAITED_S = 30.0  # time to wait for a follower: LeRobot commands with cameras take seconds to connect


class FollowerView:
    """View of one follower for its leader. Update once per tick.

    Args:
        leader: name of the leader, for messages.
        key, own_key: keys of the follower's channel and of the leader's.
        joints, motors: numbers that the follower must have.

    Attributes:
        there: whether the follower has published within the last ticks that it holds or tracks.
        led_by_another: whether the follower tracks targets without taking them from this leader at loop rate.
        coupled: whether the follower takes this leader's targets at loop rate, by its newest state.
        follows: whether the follower is coupled, or gets this leader's targets from a caller, see `judge`.
        q, dq, setpoint: (motors,) state of the follower while `there`.
    """

    def __init__(self, leader: str, key: str, own_key: str, joints: int, motors: int):
        self._leader, self._key, self._number = leader, key, coupling_number(own_key)
        self._shape = joints, motors
        self._block = PeerBlock(key, _FIELDS)
        self._joints, self._motors = joints, motors
        self._since_s: float | None = None  # since when the follower is awaited
        self._told: str | None = ""  # what is wrong, None when all is well
        self.there = self.coupled = self.follows = self.led_by_another = False
        self.q, self.dq, self.setpoint = np.zeros(motors), np.zeros(motors), np.zeros(motors)
        self._stamp_s = -math.inf

    def look(self, now: float) -> bool:
        """Read the follower's newest state; return `there`."""
        before, block, count = self.there, self._block, self._motors
        fresh = block.look(now)
        fits = fresh and (block.value("joints"), block.value("motors")) == self._shape
        self.there = fits and block.value("mode") in (Mode.HOLD, Mode.TRACK)
        if self.there:
            values = block.slots("q", count), block.slots("dq", count), block.slots("setpoint", count)
            self._stamp_s = min(block.slots("motor_stamp_s", self._joints), default=-math.inf)
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
        """Find out whether the follower goes to the leader's target (motors,).

        A caller that changes the leader's actions before it sends them looks like a policy with targets near the
        leader's. So this may change the gate's state, but must not move the leader.
        """
        block = self._block
        self.follows = self.coupled
        if block.value("coupled_to") == 0 and block.value("mode") == Mode.TRACK:
            self.follows = largest((self.setpoint - target)[: self._joints]) < _NEAR_RAD

    def q_at(self, now: float) -> np.ndarray:
        """Return the position (joints,) at present, extrapolated from the newest sample, rad."""
        j = slice(self._joints)
        q: np.ndarray = self.q[j] + self.dq[j] * (now - self._stamp_s)
        return q

    def _tell(self, now: float, other: bool) -> None:
        """Log once what is wrong, and once when all is well again."""
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
