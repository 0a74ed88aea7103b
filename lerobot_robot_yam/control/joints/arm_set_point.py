"""Set-point of one arm: starts at the measured pose, and is moved back towards the joints where they lag too far."""

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

LEFT_BEHIND_RAD = 0.05
"""Distance from a set-point that exceeds the lag of an arm with its own gains."""
_HOLDS_RAD = 0.3  # maximum distance between a set-point and the arm that it holds
_END_DECELERATION_RAD_S2 = 5.0  # at range ends: arms that brake harder overshoot by centimetres, into their stops
_GRIPPER_ACCELERATION = 60.0  # acceleration limit of the gripper, strokes/s²
_FREE_RAD = 0.1  # minimum lag behind the set-point of a joint that comes free
_FREE_SPEED = 1.1  # minimum speed of a joint that comes free, as a share of the speed limit
_TOLD_S = 0.1  # duration of the report that a joint came free, s: long enough for callers that poll at 30 Hz


class ArmSetPoint(SetPoint):
    """Set-point for an arm's n motors, the gripper last.

    Args:
        hardware: the arm.
        estimate: measured joint state.

    Attributes:
        sunk: (joints,) bool, joints that sank away from their set-points during a landing while their motors were
            silent. Sunk joints are commanded damping only, until their motors reply again.
    """

    def __init__(self, hardware: ResolvedArm, estimate: JointEstimate):
        grips, self._joints = [_GRIPPER_ACCELERATION] * hardware.has_gripper, hardware.joints
        super().__init__(
            hardware.speed_limit,
            np.append(hardware.acceleration_limit, grips),
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
        """Measured position (n,), or the last set-point of a joint whose motor is silent but may still obey."""
        estimate = self._estimate
        return estimate.q if estimate.all_usable else np.where(estimate.unheard(), self.q, estimate.q)

    def adopt(self, record: np.ndarray) -> None:
        """Start at a dead loop's set-point where that set-point holds the joint, else at the measured position.

        record: last state published by the dead loop.
        """
        slots, j, q = self._hardware.slots, self._joints, self._estimate.q
        before = record["setpoint"][slots]
        holds_it = np.abs(before - q) < (_HOLDS_RAD if record["own_gains"] else LEFT_BEHIND_RAD)
        holds_it &= ~record["sunk"][slots].astype(bool)  # a sunk joint starts at its measured position
        unheard = record["stamp_s"] - record["motor_stamp_s"][slots] > SILENT_S  # a silent joint may obey
        holds_it |= unheard & (record["fault"][slots] == Fault.NORMAL) & ~self._estimate.heard()
        holds_it[j:] = np.isfinite(before[j:])  # the gripper's set-point determines its grip force
        self.seed(np.where(holds_it, before, q))

    def start(self) -> None:
        """Restart, at rest, at the measured pose (`here`)."""
        self.seed(self.here)

    def start_joints(self) -> None:
        """Restart the joints, at rest, at the measured pose; the gripper keeps its set-point, and so its grip force."""
        q = self.here.copy()
        q[self._joints :] = self.q[self._joints :]
        self.seed(q)

    def float_along(self, grips: bool) -> None:
        """Move the set-point with the floating arm. grips: whether the gripper's set-point is left alone."""
        if grips:
            self.seed_first(self.here[: self._joints])
        else:
            self.start()

    def start_one(self, index: int) -> None:
        """Restart one coordinate, at rest, from its measured value."""
        self.reseed(index, float(self._estimate.q[index]))

    def keep_disbelieved(self, sent_q: np.ndarray) -> None:
        """Restart newly distrusted joints at the positions commanded last, sent_q (n,).

        The distance between such joints and their set-points is unknown.
        """
        for joint in self._estimate.disbelieved:
            self.reseed(joint, float(sent_q[joint]))

    def fetch_sunk(self, lands: bool) -> None:
        """Restart sunk joints at their measured positions once their motors reply. lands: whether to keep targets."""
        if any_of(self.sunk):  # rare
            heard = self.sunk & (self._estimate.usable & self._estimate.heard())[: self._joints]
            start = self.fall_back if lands else self.reseed
            for joint in np.flatnonzero(heard):
                start(int(joint), float(self._estimate.q[joint]))
            self.sunk = self.sunk & ~heard

    def catch(self, now: float) -> bool:
        """Stop joints that come free of an obstacle, so that they do not spring forward to their set-points.

        Return whether a joint has come free within the last 0.1 s.
        """
        estimate, j = self._estimate, slice(self._joints)
        dq = estimate.motor_dq[j]
        fast = np.abs(dq) > self._free_speed
        if not any_of(fast):  # the usual case
            return now - self._came_free_s < _TOLD_S
        gap = (self.q - estimate.motor_q)[j]
        behind = np.abs(gap) > _FREE_RAD + self._free_speed * estimate.age_s(now)  # moved since the sample
        free = np.flatnonzero(fast & (gap * dq > 0.0) & behind & estimate.is_fresh(now)).tolist()
        for joint in free:
            name = self._hardware.motors[joint].name
            logger.info("%s: %s came free at %.1f rad/s; caught", self._hardware.name, name, dq[joint])
            self.fall_back(joint, float(estimate.q[joint]))
            self._came_free_s = now
        return now - self._came_free_s < _TOLD_S

    def pull_no_harder(self, before: np.ndarray, now: np.ndarray, at_once: bool) -> None:
        """Limit the pull on lagging joints when stiffness grows, by moving their set-points closer to the joints.

        Args:
            before, now: (n,) old and new stiffness, Nm/rad.
            at_once: whether a new target follows; else the joints stop at the moved set-points.
        """
        j = slice(self._joints)
        gap, kp_before, kp_now = (self.q - self.here)[j], before[j], now[j]
        lags = self._hardware.kp[j] * LEFT_BEHIND_RAD
        for joint in np.flatnonzero((kp_now > kp_before) & (kp_now * np.abs(gap) > lags)):
            keeps = float(self._estimate.q[joint] + gap[joint] * kp_before[joint] / kp_now[joint])
            (self.shift if at_once else self.reseed)(int(joint), keeps)

    def press_less(self, kp: np.ndarray, carries_nm: np.ndarray, most_nm: float | np.ndarray) -> None:
        """Move set-points closer to the joints until |kp (q_set − q) + carries_nm| ≤ most_nm.

        Args:
            kp: (n,) stiffness, Nm/rad.
            carries_nm: (joints,) correction torque that is fed forward, Nm.
            most_nm: maximum torque of spring and correction together, Nm; (joints,) or one number.
        """
        here, kp = self.here, np.maximum(kp[: self._joints], 1.0)
        gap = (self.q - here)[: self._joints]
        least = np.minimum(np.maximum(gap, (-most_nm - carries_nm) / kp), (most_nm - carries_nm) / kp)
        for joint in np.flatnonzero(least != gap):
            self.reseed(int(joint), float(here[joint] + least[joint]))

    def accelerate_as_usual(self) -> None:
        """Restore the usual acceleration limit after a landing."""
        self.limit_acceleration(self._hardware.acceleration_limit)
