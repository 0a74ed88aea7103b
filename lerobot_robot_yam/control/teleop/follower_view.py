"""What a leader knows of its follower: the newest state that the follower's control loop publishes."""

import logging
import math

import numpy as np

from lerobot_robot_yam.control.teleop.peer_block import PeerBlock
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import coupling_number
from lerobot_robot_yam.system.few_values import largest

logger = logging.getLogger(__name__)

_FIELDS = ("mode", "joints", "motors", "q", "dq", "setpoint", "motor_stamp_s", "coupled_to")
_NEAR_RAD = 0.3  # a set-point so near to the leader's target is on its way there, whoever has passed it on
_AGE_MOST_S = 0.03
_LOST_S = 0.1  # before anything is said: after an emergency stop two loops do not go on in the same tick
_AWAITED_S = 30.0  # a LeRobot command that opens cameras takes seconds to connect its robot


class FollowerView:
    """Shows one follower to its leader. Ask once per tick.

    Args:
        leader: name of the leader, for messages.
        key, own_key: keys of the follower's channel and of the leader's.
        joints, motors: that the follower has to have.

    Attributes:
        there: it has said within the last ticks that it holds or tracks.
        led_by_another: it tracks targets that it does not take from this leader at loop rate.
        coupled: it takes this leader's targets at loop rate, as far as it has said.
        follows: it takes them, or goes to them at the rate of a caller, see `judge`.
        q, dq, setpoint: (motors,) while it is there.
    """

    def __init__(self, leader: str, key: str, own_key: str, joints: int, motors: int):
        self._leader, self._key, self._number = leader, key, coupling_number(own_key)
        self._shape = joints, motors
        self._block = PeerBlock(key, _FIELDS)
        self._joints, self._motors = joints, motors
        self._since_s: float | None = None  # awaited
        self._told: str | None = ""  # what is wrong, None when all is well
        self.there = self.coupled = self.follows = self.led_by_another = False
        self.q, self.dq, self.setpoint = np.zeros(motors), np.zeros(motors), np.zeros(motors)
        self._stamp_s = -math.inf

    def look(self, now: float) -> bool:
        """Read its newest state; whether it is there."""
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
        """Find out whether it follows the leader's target (motors,).

        A caller that changes actions before it passes them on cannot be told from a policy that is near by. So this
        may move the gate on, but must not move the leader.
        """
        block = self._block
        self.follows = self.coupled
        if block.value("coupled_to") == 0 and block.value("mode") == Mode.TRACK:
            self.follows = largest((self.setpoint - target)[: self._joints]) < _NEAR_RAD

    def q_at(self, now: float) -> np.ndarray:
        """(joints,) rad at present, carried on from its newest sample."""
        j = slice(self._joints)
        q: np.ndarray = self.q[j] + self.dq[j] * (now - self._stamp_s)
        return q

    def _tell(self, now: float, other: bool) -> None:
        """Say once what is wrong, and once that it is well again."""
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
        """Let go of the block. Idempotent."""
        self._block.close()
