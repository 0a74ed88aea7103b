"""Actuation of one arm: motors, set-point and control laws."""

from typing import TYPE_CHECKING

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.arm_status import ArmStatus
from lerobot_robot_yam.control.impedance import Assist, Impedance, gravity_model
from lerobot_robot_yam.control.joints.arm_set_point import ArmSetPoint
from lerobot_robot_yam.control.joints.joint_interface import JointInterface
from lerobot_robot_yam.control.landing.landing import Landing
from lerobot_robot_yam.control.laws import mit_laws
from lerobot_robot_yam.control.mode_command import ModeCommand
from lerobot_robot_yam.control.safety.channel_monitor import BusLoss, Finding
from lerobot_robot_yam.control.safety.torque_check import TorqueCheck
from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.tables import motor_type
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.system.few_values import any_of

if TYPE_CHECKING:
    from lerobot_robot_yam.arm.dynamics import GravityModel


class Actuation:
    """Motors, set-point and control laws of one arm.

    Args:
        hardware: the arm.
        interface: the arm's motors.
        status: mode, fault and pending requests of the arm.
        gravity: the arm's gravity model; None: create one.

    Attributes:
        estimate: measured joint state.
        commands: (n, 5) commands for the next `send`, in joint coordinates.
        finding: result of the last `check`.
        limp: indices of motors that are being enabled, commanded zero torque.
        landing: the landing in progress, owned by `landing_response`; None: no landing.
        grips: whether the gripper follows its set-point while a hand guides the floating arm.
        assist: torque and damping added to gravity compensation while the arm floats; None: none.
    """

    def __init__(
        self,
        hardware: ResolvedArm,
        interface: JointInterface,
        status: ArmStatus,
        gravity: "GravityModel | None" = None,
    ):
        self.hardware = hw = hardware
        self.config, self.name, self.status = hw.config, hw.name, status
        self._interface, self.gripper, self.estimate = interface, interface.gripper, interface.estimate
        self.setpoint = ArmSetPoint(hw, self.estimate)
        self.impedance = Impedance(hw, gravity or gravity_model(hw), self.gripper)
        self._law = ModeCommand(hw, status, self.estimate, self.setpoint, self.impedance, self.gripper)
        motors = hw.motors[: hw.joints]
        self._torques = TorqueCheck(np.array([motor_type(motor.type).torque_max_nm for motor in motors]))
        self._lost: np.ndarray = np.zeros(hw.joints, dtype=bool)  # joints distrusted while they had no stiffness
        self.commands: np.ndarray = np.zeros((hw.n, 5))
        self.landing: Landing | None = None
        self.grips = False
        self.assist: Assist | None = None
        self.finding = Finding(~self.estimate.usable)
        self.limp: list[int] = []
        self.bus_loss = BusLoss()

    @property
    def chain(self) -> MotorChain:
        """The motors."""
        return self._interface.chain

    @property
    def q(self) -> np.ndarray:
        """Measured joint positions (n,), rad; gripper 0 closed … 1 open."""
        return self.estimate.q

    @property
    def opening(self) -> float:
        """Gripper opening, 0 closed … 1 open; 1 if there is no gripper motor or its stops are unknown."""
        return 1.0 if self.gripper is None or self.gripper.stops is None else float(self.q[-1])

    @property
    def sunk(self) -> np.ndarray:
        """(joints,) bool, joints that sank during this or a former landing, see `ArmSetPoint`."""
        return self.setpoint.sunk if self.landing is None else self.setpoint.sunk | self.landing.sunk

    def end_landing(self) -> None:
        """End the landing; sunk joints stay marked as sunk."""
        self.setpoint.sunk, self.landing = self.sunk, None
        self.setpoint.accelerate_as_usual()

    def check(self, now: float) -> Finding:
        """Check which motors are reliable; update the estimate and the set-points of distrusted and sunk joints."""
        chain, estimate, j = self.chain, self.estimate, slice(self.hardware.joints)
        sent = self._interface.sent  # without stiffness, the motor holds nowhere
        readings = estimate.motor_q[j], estimate.motor_dq[j], estimate.tau[j], chain.stamp_s[j], estimate.usable[j]
        lying = self._torques.lying(sent[j], *readings)
        if lying:
            chain.feedback.distrust(lying, chain.position_rad)
        self.finding = estimate.check(now)
        self.setpoint.keep_disbelieved(np.where(sent[:, mit_laws.KP] > 0.0, sent[:, mit_laws.Q], estimate.motor_q))
        for joint in estimate.disbelieved:
            self._lost[joint] = sent[joint, mit_laws.KP] == 0.0
        if any_of(self._lost):  # rare
            self._lost = self._lost & ~estimate.usable[j]
        self.setpoint.fetch_sunk(self.landing is not None)
        return self.finding

    def send(self) -> None:
        """Send this tick's commands.

        Raises:
            BusError: the channel does not accept the frames.
            ActionError: the commands are not finite.
        """
        self._interface.send(self.commands)
        self.bus_loss.clear()

    def compute_command(self, now: float, dt: float) -> None:
        """Compute the commands for the next `send` from state and set-point. now, dt: time and tick period, s."""
        self.commands = self._law.compute(now, dt, self.landing, self.grips, self.assist)
        if any_of(self._lost):
            j = slice(self.hardware.joints)
            mit_laws.hold_softly(self.commands[j], self._lost, self.hardware.torque_limit_nm[j])
        if self.limp:
            self.commands[self.limp, mit_laws.KP :] = 0.0

    def enter(self, mode: Mode) -> None:
        """Change the mode; only TRACK keeps a target's gains. Raises LifeCycleError: no transition to `mode`."""
        self.status.check(mode)
        if mode is Mode.LAND:
            self.impedance.live.reset()  # landings are designed for the configured gains
        if mode is not Mode.TRACK:
            self.use_gains()
        self.status.enter(mode)
        self.grips = False

    def use_gains(self, kp: np.ndarray | None = None, kd: np.ndarray | None = None) -> None:
        """Use the gains (n,) of a target; NaN or None: the arm's own gains.

        A soft arm may be far from its set-point. When stiffness grows, set-points are moved closer to the joints, so
        that the pull on each joint does not exceed its former value or, if larger, the pull of the configured gain
        across a gap of `arm_set_point.LEFT_BEHIND_RAD`.
        """
        before = self.impedance.kp
        self.impedance.gains(kp, kd)
        self.setpoint.pull_no_harder(before, self.impedance.kp, kp is not None)

    def change_gains(self, kp: np.ndarray, kd: np.ndarray) -> None:
        """Change the arm's own gains (n,) without torque jumps; NaN: as configured. Gains of targets stay in force."""
        self.setpoint.pull_no_harder(self.impedance.kp, np.where(np.isnan(kp), self.hardware.kp, kp), False)
        self.impedance.live.change(kp, kd)

    def repeat(self) -> None:
        """Repeat the last commands at zero speed. Used after an internal error, instead of computing new commands."""
        self.commands = self._interface.sent.copy()
        self.commands[:, mit_laws.DQ] = 0.0

    def stop_moving(self) -> None:
        """Brake the set-point and end the search for the gripper's stops."""
        self.setpoint.stop()
        if self.gripper is not None:
            self.gripper.stop_search()

    def hold_here(self) -> None:
        """Brake to a stop and enter HOLD; a floating arm then holds its present pose."""
        self.setpoint.stop()
        self.enter(Mode.HOLD)
