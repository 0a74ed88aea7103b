"""Set-point of one arm: how it starts from the measured pose, and how it is brought back to it."""

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
_HOLDS_RAD = 0.3  # largest distance of a set-point that still holds the arm
_END_DECELERATION_RAD_S2 = 5.0  # at range ends: an arm overshoots a harder stop by centimetres, into its stops
_GRIPPER_ACCELERATION = 60.0  # acceleration limit of the gripper, strokes/s²
_FREE_RAD = 0.1  # way behind its set-point of a joint that comes free
_FREE_SPEED = 1.1  # share of the speed limit that a joint that comes free exceeds
_TOLD_S = 0.1  # how long a joint that came free is reported, s: a caller that looks 30 times a second sees it


class ArmSetPoint(SetPoint):
    """Set-point of an arm's n motors, the gripper's last.

    Args:
        hardware: the arm.
        estimate: where the arm is.

    Attributes:
        sunk: (joints,) bool, joints that a landing has let sink unheard, away from their set-points. They only get
            damping until they are heard again.
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
        """Measured position (n,), but the last set-point of a joint that is not heard and may obey all the same."""
        estimate = self._estimate
        return estimate.q if estimate.all_usable else np.where(estimate.unheard(), self.q, estimate.q)

    def adopt(self, record: np.ndarray) -> None:
        """Start at the set-point of a loop that has died, where that set-point is what holds the arm.

        record: the last state that this loop published.
        """
        slots, j, q = self._hardware.slots, self._joints, self._estimate.q
        before = record["setpoint"][slots]
        holds_it = np.abs(before - q) < (_HOLDS_RAD if record["own_gains"] else LEFT_BEHIND_RAD)
        holds_it &= ~record["sunk"][slots].astype(bool)  # a sunk joint starts where it is measured
        unheard = record["stamp_s"] - record["motor_stamp_s"][slots] > SILENT_S  # a silent joint may obey
        holds_it |= unheard & (record["fault"][slots] == Fault.NORMAL) & ~self._estimate.heard()
        holds_it[j:] = np.isfinite(before[j:])  # the gripper's set-point is its grip
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
        """Stay where the arm is while it floats; with `grips` the gripper's set-point goes on."""
        if grips:
            self.seed_first(self.here[: self._joints])
        else:
            self.start()

    def start_one(self, index: int) -> None:
        """Start one coordinate again from its measured value."""
        self.reseed(index, float(self._estimate.q[index]))

    def keep_disbelieved(self, sent_q: np.ndarray) -> None:
        """Keep joints that have become distrusted where they were sent last, sent_q (n,).

        Nobody knows how far such joints are from their set-points.
        """
        for joint in self._estimate.disbelieved:
            self.reseed(joint, float(sent_q[joint]))

    def fetch_sunk(self, lands: bool) -> None:
        """Start joints that had sunk unheard, and are heard again, where they are; a landing goes on from there."""
        if any_of(self.sunk):  # rarely
            heard = self.sunk & (self._estimate.usable & self._estimate.heard())[: self._joints]
            start = self.fall_back if lands else self.reseed
            for joint in np.flatnonzero(heard):
                start(int(joint), float(self._estimate.q[joint]))
            self.sunk = self.sunk & ~heard

    def catch(self, now: float) -> bool:
        """Stop joints that come free of an obstacle: they must not spring to where their set-points have gone.

        Return whether a joint has come free within the last 0.1 s.
        """
        estimate, j = self._estimate, slice(self._joints)
        dq = estimate.motor_dq[j]
        fast = np.abs(dq) > self._free_speed
        if not any_of(fast):  # nearly always
            return now - self._came_free_s < _TOLD_S
        gap = (self.q - estimate.motor_q)[j]
        behind = np.abs(gap) > _FREE_RAD + self._free_speed * estimate.age_s(now)  # joints have moved since
        free = np.flatnonzero(fast & (gap * dq > 0.0) & behind & estimate.is_fresh(now)).tolist()
        for joint in free:
            name = self._hardware.motors[joint].name
            logger.info("%s: %s came free at %.1f rad/s; caught", self._hardware.name, name, dq[joint])
            self.fall_back(joint, float(estimate.q[joint]))
            self._came_free_s = now
        return now - self._came_free_s < _TOLD_S

    def pull_no_harder(self, before: np.ndarray, now: np.ndarray, at_once: bool) -> None:
        """Bring set-points closer where stiffness grows from `before` to `now`, (n,), far from the measured joint.

        at_once: whether a target follows; else the joints come to rest there.
        """
        j = slice(self._joints)
        gap, kp_before, kp_now = (self.q - self.here)[j], before[j], now[j]
        lags = self._hardware.kp[j] * LEFT_BEHIND_RAD
        for joint in np.flatnonzero((kp_now > kp_before) & (kp_now * np.abs(gap) > lags)):
            keeps = float(self._estimate.q[joint] + gap[joint] * kp_before[joint] / kp_now[joint])
            (self.shift if at_once else self.reseed)(int(joint), keeps)

    def press_less(self, kp: np.ndarray, carries_nm: np.ndarray, most_nm: float) -> None:
        """Reduce the pull of joints, gains kp (n,), to `most_nm` beside the load they carry, carries_nm (joints,)."""
        here, kp = self.here, np.maximum(kp[: self._joints], 1.0)
        gap = (self.q - here)[: self._joints]
        least = np.minimum(np.maximum(gap, (-most_nm - carries_nm) / kp), (most_nm - carries_nm) / kp)
        for joint in np.flatnonzero(least != gap):
            self.reseed(int(joint), float(here[joint] + least[joint]))

    def accelerate_as_usual(self) -> None:
        """Forget the acceleration limit of a landing."""
        self.limit_acceleration(np.full(self._joints, ACCELERATION_LIMIT_RAD_S2))
