"""Set-point of one arm: where it starts from the arm, and where it is brought back to the arm."""

import logging
import math

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.joints.estimate import JointEstimate
from lerobot_robot_yam.control.laws.set_point import SetPoint
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.state.faults import SILENT_S
from lerobot_robot_yam.system.few_values import any_of

logger = logging.getLogger(__name__)

ACCELERATION_LIMIT_RAD_S2 = 30.0
"""Brakes from the speed limit within 50 ms."""
LEFT_BEHIND_RAD = 0.05
"""More than an arm lags with its own gains."""
_HOLDS_RAD = 0.3  # a set-point farther than this from the arm is not what holds it
_END_DECELERATION_RAD_S2 = 5.0  # an arm overshoots a harder stop by centimetres, and joints end on mechanical stops
_GRIPPER_ACCELERATION = 60.0  # strokes/s²
_FREE_RAD = 0.1  # a joint this far behind its set-point, and
_FREE_SPEED = 1.1  # faster than this share of its speed limit, has come free
_TOLD_S = 0.1  # that it has is told for this long, s: a caller that looks 30 times a second sees it


class ArmSetPoint(SetPoint):
    """Set-point of an arm's n motors, the gripper's last.

    Args:
        hardware: the arm.
        estimate: where the arm is.

    Attributes:
        sunk: (joints,) bool, joints that a landing has let sink unheard: they have left their set-points. Until they
            are heard again they only get damping.
    """

    def __init__(self, hardware: ResolvedArm, estimate: JointEstimate):
        grips, self._joints = [_GRIPPER_ACCELERATION] * hardware.has_gripper, hardware.joints
        super().__init__(
            hardware.speed_limit,
            np.append(np.full(hardware.joints, ACCELERATION_LIMIT_RAD_S2), grips),
            hardware.lower,
            hardware.upper,
            np.append(np.full(hardware.joints, _END_DECELERATION_RAD_S2), grips),
        )
        self._hardware, self._estimate = hardware, estimate
        self._free_speed = _FREE_SPEED * hardware.speed_limit[: hardware.joints]
        self.sunk: np.ndarray = np.zeros(hardware.joints, dtype=bool)
        self._came_free_s = -math.inf

    @property
    def here(self) -> np.ndarray:
        """(n,) as measured, but a joint that is not heard, and may obey all the same, is where it was sent."""
        estimate = self._estimate
        return estimate.q if estimate.all_usable else np.where(estimate.unheard(), self.q, estimate.q)

    def adopt(self, record: np.ndarray) -> None:
        """Start where a loop that has died has asked the arm to be, if that is what holds it.

        record: the state that it has published last.
        """
        slots, j, q = self._hardware.slots, self._joints, self._estimate.q
        before = record["setpoint"][slots]
        holds_it = np.abs(before - q) < (_HOLDS_RAD if record["own_gains"] else LEFT_BEHIND_RAD)
        holds_it &= ~record["sunk"][slots].astype(bool)  # it is where it is heard, if it is
        unheard = record["stamp_s"] - record["motor_stamp_s"][slots] > SILENT_S  # but perhaps it obeys
        holds_it |= unheard & (record["fault"][slots] == Fault.NORMAL) & ~self._estimate.heard()
        holds_it[j:] = np.isfinite(before[j:])  # its grip, however thick
        self.seed(np.where(holds_it, before, q))

    def start(self) -> None:
        """Start again, at rest, from where the arm is."""
        self.seed(self.here)

    def start_joints(self) -> None:
        """Start the joints again, at rest, from where they are; the gripper keeps its set-point, which is its grip."""
        q = self.here.copy()
        q[self._joints :] = self.q[self._joints :]
        self.seed(q)

    def float_along(self, grips: bool) -> None:
        """Stay where the arm is while it floats; a gripper that grips goes on."""
        if grips:
            self.seed_first(self.here[: self._joints])
        else:
            self.start()

    def start_one(self, index: int) -> None:
        """Start one coordinate again from its measured value."""
        self.reseed(index, float(self._estimate.q[index]))

    def keep_disbelieved(self, sent_q: np.ndarray) -> None:
        """Keep joints that are not believed any more where they were sent last, sent_q (n,).

        Nobody knows any more how far they are from their set-points.
        """
        for joint in self._estimate.disbelieved:
            self.reseed(joint, float(sent_q[joint]))

    def fetch_sunk(self, lands: bool) -> None:
        """Start joints that had sunk unheard, and are heard again, where they are; a landing goes on from there."""
        if any_of(self.sunk):  # hardly ever
            heard = self.sunk & (self._estimate.usable & self._estimate.heard())[: self._joints]
            start = self.fall_back if lands else self.reseed
            for joint in np.flatnonzero(heard):
                start(int(joint), float(self._estimate.q[joint]))
            self.sunk = self.sunk & ~heard

    def catch(self, now: float) -> bool:
        """Stop joints that come free of an obstacle: they must not spring to where their set-points have gone.

        Returns whether one has, within the last 0.1 s.
        """
        estimate, j = self._estimate, slice(self._joints)
        dq = estimate.motor_dq[j]
        fast = np.abs(dq) > self._free_speed
        if not any_of(fast):  # nearly always
            return now - self._came_free_s < _TOLD_S
        gap = (self.q - estimate.motor_q)[j]
        behind = np.abs(gap) > _FREE_RAD + self._free_speed * estimate.age_s(now)  # it has gone on since the sample
        free = np.flatnonzero(fast & (gap * dq > 0.0) & behind & estimate.is_fresh(now)).tolist()
        for joint in free:
            name = self._hardware.motors[joint].name
            logger.info("%s: %s came free at %.1f rad/s; caught", self._hardware.name, name, dq[joint])
            self.fall_back(joint, float(estimate.q[joint]))
            self._came_free_s = now
        return now - self._came_free_s < _TOLD_S

    def pull_no_harder(self, before: np.ndarray, now: np.ndarray, at_once: bool) -> None:
        """Bring joints back whose stiffness grows from `before` to `now`, (n,), far from where they are.

        at_once: a target follows; else they come to rest there.
        """
        j = slice(self._joints)
        gap, kp_before, kp_now = (self.q - self.here)[j], before[j], now[j]
        lags = self._hardware.kp[j] * LEFT_BEHIND_RAD
        for joint in np.flatnonzero((kp_now > kp_before) & (kp_now * np.abs(gap) > lags)):
            keeps = float(self._estimate.q[joint] + gap[joint] * kp_before[joint] / kp_now[joint])
            (self.shift if at_once else self.reseed)(int(joint), keeps)

    def press_less(self, kp: np.ndarray, carries_nm: np.ndarray, most_nm: float) -> None:
        """Reduce what joints pull with, kp (n,), to `most_nm` beside the load that they carry, carries_nm (joints,)."""
        here, kp = self.here, np.maximum(kp[: self._joints], 1.0)
        gap = (self.q - here)[: self._joints]
        least = np.minimum(np.maximum(gap, (-most_nm - carries_nm) / kp), (most_nm - carries_nm) / kp)
        for joint in np.flatnonzero(least != gap):
            self.reseed(int(joint), float(here[joint] + least[joint]))

    def accelerate_as_usual(self) -> None:
        """Forget the acceleration limit of a landing."""
        self.limit_acceleration(np.full(self._joints, ACCELERATION_LIMIT_RAD_S2))
