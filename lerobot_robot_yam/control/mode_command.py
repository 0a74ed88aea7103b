"""Commands of one arm according to its mode: float, or follow the set-point."""

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.arm_status import ArmStatus
from lerobot_robot_yam.control.gripper.gripper import Gripper
from lerobot_robot_yam.control.impedance import Assist, Impedance, Inputs
from lerobot_robot_yam.control.joints.arm_set_point import ArmSetPoint
from lerobot_robot_yam.control.joints.estimate import JointEstimate
from lerobot_robot_yam.control.landing.landing import Landing
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Limited
from lerobot_robot_yam.system.few_values import any_of

_TOLD_AFLOAT = Limited.JOINT_LIMIT | Limited.TORQUE  # limits reported only while they act


class ModeCommand:
    """Computes commands from an arm's state and set-point.

    Args:
        hardware, status, estimate, setpoint, impedance: parts of one arm.
        gripper: the gripper's axis, or None if the gripper has no motor.
    """

    def __init__(
        self,
        hardware: ResolvedArm,
        status: ArmStatus,
        estimate: JointEstimate,
        setpoint: ArmSetPoint,
        impedance: Impedance,
        gripper: Gripper | None,
    ):
        self._hardware, self._status, self._gripper = hardware, status, gripper
        self._estimate, self._setpoint, self._impedance = estimate, setpoint, impedance

    def compute(self, now: float, dt: float, landing: Landing | None, grips: bool, assist: Assist | None) -> np.ndarray:
        """Compute commands (n, 5) in joint coordinates.

        Args:
            now, dt: time, and time since the last tick, s.
            landing: the landing in progress, or None.
            grips, assist: see `Inputs`; used only while the arm floats.
        """
        status, setpoint = self._status, self._setpoint
        pressed = self._gripper is not None and self._gripper.force_limited
        if status.afloat:
            commands = self._float(now, dt, grips, assist)
        else:
            self._catch(now, landing)
            commands = self._follow(now, dt, landing)
        if pressed and self._gripper is not None and not self._gripper.force_limited:
            # The gripped object is gone: restart at the measured opening, so that the fingers do not snap shut.
            if grips or not status.afloat:
                setpoint.start_one(self._hardware.n - 1)
            if not status.afloat:
                commands = self._follow(now, 0.0, landing)
        if any_of(setpoint.sunk):
            self._impedance.sink(commands, setpoint.sunk)
        return commands

    def _inputs(self, now: float, dt: float) -> Inputs:
        estimate, setpoint = self._estimate, self._setpoint
        q: np.ndarray = estimate.motor_q
        dq: np.ndarray = estimate.motor_dq
        whole = estimate.all_usable
        if not whole:
            unheard = estimate.unheard()
            q, dq = np.where(unheard, setpoint.q, q), np.where(unheard, setpoint.dq, dq)
        gripper = float(estimate.dq[-1]), float(estimate.tau[-1])
        mode = self._status.mode
        return Inputs(now, dt, q, dq, gripper, setpoint.asked, setpoint.asked_ddq, mode, whole)

    def _float(self, now: float, dt: float, grips: bool, assist: Assist | None) -> np.ndarray:
        status = self._status
        self._setpoint.float_along(grips)  # so that the set-point is at the measured pose when floating ends
        if status.limited:
            status.limited &= ~_TOLD_AFLOAT
        if status.mode is not Mode.FLOAT or not self._estimate.all_usable:
            assist = None
        commands, limited = self._impedance.float_free(self._inputs(now, dt)._replace(assist=assist, grips=grips))
        self._tell(limited)
        return commands

    def _follow(self, now: float, dt: float, landing: Landing | None) -> np.ndarray:
        inputs = self._inputs(now, dt)
        feed_nm, share = self._impedance.feed_forward(inputs)
        if share is not None:
            hw = self._hardware
            self._setpoint.hold_back(np.append(np.full(hw.joints, share), [1.0] * hw.has_gripper))
            inputs = inputs._replace(asked=self._setpoint.asked)
            self._tell(Limited.TORQUE if share < 1.0 else Limited.NOTHING)
        if landing is not None:
            inputs = inputs._replace(learns=landing.learns, fade=landing.fade)
        commands, limited = self._impedance.follow(inputs._replace(feed_nm=feed_nm))
        self._tell(limited)
        return commands

    def _tell(self, limited: Limited) -> None:
        """Add `limited` to the reported limits, unless empty: combining flags is slow."""
        if limited:
            self._status.limited |= limited

    def _catch(self, now: float, landing: Landing | None) -> None:
        """Catch joints that come free, unless the arm already fades or sinks; report a catch for a while."""
        status = self._status
        if (landing is None or landing.fade is None) and self._setpoint.catch(now):
            status.limited |= Limited.CAME_FREE  # until a new target resets the limits
        elif status.limited:  # while an arm holds, no target resets the limits
            status.limited &= ~Limited.CAME_FREE
