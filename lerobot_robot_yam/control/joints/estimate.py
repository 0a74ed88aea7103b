"""Measured state of each joint of an arm, with the age of the sample and whether the motor is reliable."""

import math

import numpy as np

from lerobot_robot_yam.arm.joint_map import JointMap
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.gripper.gripper import Gripper
from lerobot_robot_yam.control.safety.channel_monitor import ChannelMonitor, Finding
from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.state.faults import SILENT_S

_JUST_NOW_S = 0.02  # maximum age of a fresh sample, s; the adapter's delay is added


class JointEstimate:
    """Estimate of n joints, the gripper last.

    Args:
        hardware: the arm.
        chain: the arm's motors.
        turns: map from motor to joint coordinates.
        gripper: the gripper's axis, or None if the gripper has no motor.

    Attributes:
        q, dq, tau: (n,) rad, rad/s, Nm; the gripper's q is 0 closed … 1 open, its dq strokes/s.
        motor_q, motor_dq: (n,) rad and rad/s, also for the gripper.
        usable, all_usable: (n,) bool, reliable motors, and whether all motors are reliable.
        disbelieved: joints, without the gripper, whose readings became distrusted at the last `check`.
    """

    def __init__(self, hardware: ResolvedArm, chain: MotorChain, turns: JointMap, gripper: Gripper | None):
        n, self._joints = hardware.n, hardware.joints
        self._direction, self._chain, self._map, self._gripper = hardware.direction, chain, turns, gripper
        self._watch = ChannelMonitor(chain)
        self.q, self.dq, self.tau = np.zeros(n), np.zeros(n), np.zeros(n)
        self.motor_q, self.motor_dq = np.zeros(n), np.zeros(n)
        self._bad = np.zeros(n, dtype=bool)
        self.usable, self.all_usable = ~self._bad, True
        self.disbelieved: list[int] = []

    def read(self) -> None:
        """Update the estimate from the newest replies."""
        chain, direction = self._chain, self._direction
        self.motor_q = self._map.position(chain.position_rad)
        self.motor_dq = chain.velocity_rad_s * direction
        self.tau = chain.torque_nm * direction
        self.q, self.dq = self.motor_q.copy(), self.motor_dq.copy()
        if self._gripper is not None:
            self.q[-1], self.dq[-1] = self._gripper.normalised(float(self.motor_q[-1]), float(self.motor_dq[-1]))

    def find_trouble(self, now: float) -> Finding:
        """Check for unreliable motors without changing the estimate; `check` changes `usable`."""
        return self._watch.check(now)

    def check(self, now: float) -> Finding:
        """Check for unreliable motors; update `usable`, `all_usable` and `disbelieved`."""
        chain = self._chain
        finding = self.find_trouble(now)
        self.disbelieved = []
        if finding.bad is not self._bad:  # the same array as long as all motors are well
            newly = (chain.distrusted & finding.bad & ~self._bad)[: self._joints]
            self.disbelieved = np.flatnonzero(newly).tolist()
            self._bad, self.usable = finding.bad, ~finding.bad
            self.all_usable = bool(self.usable.all())
        return finding

    def unheard(self) -> np.ndarray:
        """Return (n,) bool: joints whose motors are silent or distrusted but have not reported to be limp."""
        chain = self._chain
        unheard = ~self.usable & ((chain.silence_s(chain.clock.now()) > SILENT_S) | chain.distrusted)
        unheard &= (chain.fault == Fault.NORMAL) | ~self.heard()
        unheard[self._joints :] = False
        return unheard

    def heard(self) -> np.ndarray:
        """Return (n,) bool: motors that have replied at least once."""
        return np.isfinite(self._chain.stamp_s)

    def oldest_s(self) -> float:
        """Return the timestamp of the oldest sample among the usable motors, s; inf if no motor is usable."""
        stamp_s = self._chain.stamp_s if self.all_usable else self._chain.stamp_s[self.usable]
        return min(stamp_s.tolist(), default=math.inf)

    def age_s(self, now: float) -> np.ndarray:
        """Return the age of each joint's newest sample (joints,), s."""
        return now - self._chain.stamp_s[: self._joints]

    def is_fresh(self, now: float) -> np.ndarray:
        """Return (joints,) bool: joints with usable motors and fresh samples, which are therefore not limp."""
        return self.usable[: self._joints] & (self.age_s(now) < _JUST_NOW_S + self._chain.round_trip.one_way_s)
