"""From set-point and measured state to this tick's MIT commands: feed-forward, laws, clips. No life cycle, no clock."""

import numpy as np

from lerobot_robot_yam.arm import laws
from lerobot_robot_yam.arm.dynamics import GravityModel
from lerobot_robot_yam.arm.gripper_axis import GripperAxis
from lerobot_robot_yam.arm.hardware import Hardware
from lerobot_robot_yam.arm.hold_integral import HoldIntegral
from lerobot_robot_yam.arm.setpoint import SetPoint
from lerobot_robot_yam.arm.state import Limited

_STILL_RAD_S = 1e-3
_WORTH_SAYING_RAD = 0.01  # rest lies on a limit for some joints
_LANDING_KD = 5.0  # Nm s/rad, the most that the motors take: what is still unsupported sinks slowly


class Motion:
    """Commands of one arm, (n, 5) in joint coordinates.

    Args:
        hardware: the arm.
        gravity: its model; None for a gripper alone.
        gripper: its gripper's axis, if it has a motor.
        hold_integral: make up for sag while holding.
    """

    def __init__(
        self, hardware: Hardware, gravity: GravityModel | None, gripper: GripperAxis | None, hold_integral: bool
    ):
        self._hardware, self._gravity, self._gripper = hardware, gravity, gripper
        self.commands = np.zeros((hardware.n, 5))
        self.kp, self.kd = hardware.kp.copy(), hardware.kd.copy()
        self._integral = HoldIntegral.for_stiffness(hardware.kp[: hardware.joints]) if hold_integral else None
        self._clipped = False

    def gains(self, kp: np.ndarray | None = None, kd: np.ndarray | None = None) -> None:
        """Use these gains (n,) from now on; NaN or None means as configured."""
        hw = self._hardware
        self.kp = hw.kp if kp is None else np.where(np.isnan(kp), hw.kp, kp)
        self.kd = hw.kd if kd is None else np.where(np.isnan(kd), hw.kd, kd)

    def float_free(self, q: np.ndarray, dq: np.ndarray, dt: float) -> Limited:
        """Gravity-compensated free motion, pushed back gently beyond the joint limits.

        q, dq: (n,) of the motors, gripper in rad; dt: s.
        """
        hw, out = self._hardware, self.commands
        j = slice(hw.joints)
        tau = self._weight(q)
        tau[j] += laws.friction(dq[j], hw.coulomb_nm) + self._sag(np.zeros(hw.joints), dt, False)
        laws.float_free(out, q, hw.idle_kd, tau)
        wall = laws.soft_wall(out[j], q[j], dq[j], hw.lower[j], hw.upper[j], hw.kp[j], hw.kd[j], hw.torque_limit_nm[j])
        beyond = Limited.JOINT_LIMIT if wall > _WORTH_SAYING_RAD else Limited.NOTHING
        return beyond | self._clip(q, dq)

    def follow(
        self,
        now: float,
        dt: float,
        q: np.ndarray,
        dq: np.ndarray,
        setpoint: SetPoint,
        gripper: tuple[float, float],
        holding: bool,
        fade: float | None,
    ) -> Limited:
        """Hold or track the set-point.

        Args:
            now, dt: s.
            q, dq: (n,) of the motors, gripper in rad.
            gripper: measured rate and torque of the gripper, strokes/s and Nm.
            holding: the arm holds, with all its motors; nobody gives targets.
            fade: share of stiffness and feed-forward that is left while landing ends; None: all of it.
        """
        hw, out = self._hardware, self.commands
        j = slice(hw.joints)
        limited = Limited.NOTHING
        q_set, dq_set = setpoint.q.copy(), setpoint.dq.copy()
        tau = self._weight(q)
        still = holding and bool(np.abs(dq_set[j]).max(initial=0.0) < _STILL_RAD_S)
        tau[j] += laws.friction(dq_set[j], hw.coulomb_nm) + self._sag(q_set[j] - q[j], dt, still)
        laws.follow(out, q_set, dq_set, self.kp, self.kd, tau)
        if fade is not None:
            laws.fade(out, fade, np.full(hw.n, _LANDING_KD))
        if self._gripper is not None:
            u, u_rate = float(q_set[-1]), float(dq_set[-1])
            self._gripper.command(out[-1], now, u, u_rate, float(q[-1]), *gripper)
            if self._gripper.force_limited:
                limited |= Limited.GRIPPER_FORCE
        return limited | self._clip(q, dq)

    def _sag(self, error: np.ndarray, dt: float, holding: bool) -> np.ndarray | float:
        return 0.0 if self._integral is None else self._integral.advance(error, dt, holding, self._clipped)

    def _weight(self, q: np.ndarray) -> np.ndarray:
        hw = self._hardware
        tau = np.zeros(hw.n)
        if self._gravity is not None:
            tau[: hw.joints] = self._gravity.torque(q[: hw.joints]) * hw.arm.gravity_factor
        return tau

    def _clip(self, q: np.ndarray, dq: np.ndarray) -> Limited:
        self._clipped = laws.clip_torque(self.commands, q, dq, self._hardware.torque_limit_nm)
        return Limited.TORQUE if self._clipped else Limited.NOTHING
