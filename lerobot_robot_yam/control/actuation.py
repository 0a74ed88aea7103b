"""The actuation of one arm: its motors, set-point and laws, and the commands that each mode makes of them."""

import logging
import math

import can
import numpy as np

from lerobot_robot_yam.arm.dynamics import GravityModel
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.arm_status import ArmStatus
from lerobot_robot_yam.control.impedance import Impedance, Inputs, gravity_model
from lerobot_robot_yam.control.joints.arm_set_point import ArmSetPoint
from lerobot_robot_yam.control.joints.joint_interface import JointInterface
from lerobot_robot_yam.control.landing.landing import Landing
from lerobot_robot_yam.control.laws import mit_laws
from lerobot_robot_yam.control.safety.channel_monitor import BusLoss, Finding
from lerobot_robot_yam.control.safety.thermal_monitor import Heat
from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Limited
from lerobot_robot_yam.system.few_values import any_of

logger = logging.getLogger(__name__)

_TOLD_AFLOAT = Limited.JOINT_LIMIT | Limited.TORQUE  # told as long as it lasts
_TOLD_S = 0.1  # a caller that looks 30 times a second sees it
_HEAT_PERIOD_S = 0.1  # temperatures change slowly
_OFF_S = 0.05  # wait for motors to say that they are off, s; what the adapter takes is added


class Actuation:
    """Motors, set-point and laws of one arm.

    Args:
        hardware: the arm.
        bus: an open bus; not closed here.
        status: of the arm.
        gravity: its model, if that has been made before.

    Attributes:
        estimate: what is known of its joints.
        finding: of the last `check`.
        limp: motors that are being enabled, by index: they get no torque.
        landing: the landing under way; `landing_response` owns it.
        grips: while it floats its gripper keeps to the set-point: a hand guides it.
        assist: torque and damping (joints,) that act beside its weight while it floats; None: none.
    """

    def __init__(
        self,
        hardware: ResolvedArm,
        bus: can.BusABC,
        status: ArmStatus,
        gravity: GravityModel | None = None,
    ):
        self.hardware = hw = hardware
        self.config, self.name, self.status = hw.config, hw.name, status
        self.interface = JointInterface(hw, bus)
        self.gripper, self.estimate = self.interface.gripper, self.interface.estimate
        self.setpoint = ArmSetPoint(hw, self.estimate)
        self.impedance = Impedance(hw, gravity or gravity_model(hw), self.gripper)
        self.landing: Landing | None = None
        self.grips = False
        self.assist: tuple[np.ndarray, np.ndarray] | None = None
        self.finding = Finding(~self.estimate.usable)
        self.limp: list[int] = []
        self.bus_loss = BusLoss()
        self._off_by_s = math.inf
        self._heat: Heat | None = None
        self._heat_due = self._came_free_s = -math.inf

    @property
    def chain(self) -> MotorChain:
        """The motors."""
        return self.interface.chain

    @property
    def q(self) -> np.ndarray:
        """(n,) measured, rad; the gripper 0 closed … 1 open."""
        return self.estimate.q

    @property
    def opening(self) -> float:
        """How far the gripper is open, 0 closed … 1 open: wide open as long as its stops are unknown."""
        return 1.0 if self.gripper is None or self.gripper.stops is None else float(self.q[-1])

    @property
    def sunk(self) -> np.ndarray:
        """(joints,) bool, see `ArmSetPoint`; of the landing under way, too."""
        return self.setpoint.sunk if self.landing is None else self.setpoint.sunk | self.landing.sunk

    def complaints(self) -> list[str]:
        """What has to be said at the end about adapter and cable."""
        chain, where = self.chain, f"{self.name} ({self.chain.channel})"
        said = []
        if chain.round_trip.slow:
            said.append(f"{where}: {chain.round_trip.summary()}; the arm was seen and commanded that much too late")
        if chain.error_frames:
            said.append(f"{where}: CAN error frames: {chain.error_frames}; check cable, termination and bit-rate")
        return said

    def end_landing(self) -> None:
        """Land no more; what has sunk stays so."""
        self.setpoint.sunk, self.landing = self.sunk, None
        self.setpoint.accelerate_as_usual()

    def check(self, now: float) -> Finding:
        """Find out which motors can be relied on from here on."""
        self.finding = self.estimate.check(now)
        self.setpoint.keep_disbelieved(self.interface.sent[:, mit_laws.Q])
        self.setpoint.fetch_sunk(self.landing is not None)
        return self.finding

    def send(self) -> None:
        """Put this tick's commands on the wire.

        Raises:
            BusError: the channel does not take them.
            ActionError: they are not finite.
        """
        if self.status.letting_go:
            self.interface.instead = dict.fromkeys(range(self.hardware.n), SpecialCommand.DISABLE)
        self.interface.send(self.impedance.commands)
        self.bus_loss.clear()

    def compute_command(self, now: float, dt: float) -> None:
        """From state and set-point to the commands of the next `send`. now, dt: s."""
        pressed = self.gripper is not None and self.gripper.force_limited
        if self.status.afloat:
            self._float(now, dt)
        else:
            self._catch(now)
            self._follow(now, dt)
        if pressed and self.gripper is not None and not self.gripper.force_limited:
            # The object that it pressed on is gone: it goes on at its own speed, not in one leap after the set-point.
            if self.grips or not self.status.afloat:
                self.setpoint.start_one(self.hardware.n - 1)
            if not self.status.afloat:
                self._follow(now, 0.0)
        if any_of(self.setpoint.sunk):
            self.impedance.sink(self.setpoint.sunk)
        if self.limp:
            self.impedance.commands[self.limp, mit_laws.KP :] = 0.0

    def _inputs(self, now: float, dt: float) -> Inputs:
        estimate, setpoint = self.estimate, self.setpoint
        q: np.ndarray = estimate.motor_q
        dq: np.ndarray = estimate.motor_dq
        whole = estimate.all_usable
        if not whole:
            unheard = estimate.unheard()
            q, dq = np.where(unheard, setpoint.q, q), np.where(unheard, setpoint.dq, dq)
        gripper = float(estimate.dq[-1]), float(estimate.tau[-1])
        mode = self.status.mode
        return Inputs(now, dt, q, dq, estimate.before, gripper, setpoint.asked, setpoint.asked_ddq, mode, whole)

    def _float(self, now: float, dt: float) -> None:
        status = self.status
        self.setpoint.float_along(self.grips)  # whatever ends the floating finds the set-point where the arm is
        if status.limited:
            status.limited &= ~_TOLD_AFLOAT
        assist = self.assist if status.mode is Mode.FLOAT and self.estimate.all_usable else None
        self._tell(self.impedance.float_free(self._inputs(now, dt), assist, self.grips))

    def _follow(self, now: float, dt: float) -> None:
        inputs = self._inputs(now, dt)
        feed_nm, share = self.impedance.feed_forward(inputs)
        if share is not None:
            hw = self.hardware
            self.setpoint.hold_back(np.append(np.full(hw.joints, share), [1.0] * hw.has_gripper))
            inputs = inputs._replace(asked=self.setpoint.asked)
            self._tell(Limited.TORQUE if share < 1.0 else Limited.NOTHING)
        learns = self.landing is not None and self.landing.learns
        fade = None if self.landing is None else self.landing.fade
        self._tell(self.impedance.follow(inputs, feed_nm, learns, fade))

    def _tell(self, limited: Limited) -> None:
        """Add to what is told about the arm. Mostly nothing, and flags take long to combine."""
        if limited:
            self.status.limited |= limited

    def _catch(self, now: float) -> None:
        """Catch joints that come free, unless they lie or sink already, and tell of it for a while."""
        if (self.landing is None or self.landing.fade is None) and self.setpoint.catch(now):
            self._came_free_s = now
        if now - self._came_free_s < _TOLD_S:  # each new target tells anew what limits the arm
            self.status.limited |= Limited.CAME_FREE
        elif self._came_free_s > -math.inf:  # while an arm holds, no target comes to take it back
            self.status.limited &= ~Limited.CAME_FREE
            self._came_free_s = -math.inf

    def enter(self, mode: Mode) -> None:
        """Change the mode; only TRACK keeps the gains of a target. Raises LifeCycleError: not from the present mode."""
        self.status.check(mode)
        if mode is Mode.LAND:
            self.impedance.live.reset()  # landings are made for the configured gains
        if mode is not Mode.TRACK:
            self.use_gains()
        self.status.enter(mode)
        self.grips = False

    def use_gains(self, kp: np.ndarray | None = None, kd: np.ndarray | None = None) -> None:
        """Use the gains (n,) of a target, NaN or None as configured.

        A softer arm may have been left behind. Stiffer gains pull no harder than the arm was pulled before, or than it
        lags with its own gains.
        """
        before = self.impedance.kp
        self.impedance.gains(kp, kd)
        self.setpoint.pull_no_harder(before, self.impedance.kp, kp is not None)

    def change_gains(self, kp: np.ndarray, kd: np.ndarray) -> None:
        """Go over to other gains (n,) of its own, NaN as configured, so that no torque jumps; targets keep theirs."""
        self.setpoint.pull_no_harder(self.impedance.kp, np.where(np.isnan(kp), self.hardware.kp, kp), False)
        self.impedance.live.change(kp, kd)

    def derate(self, now: float) -> Heat | None:
        """Let warm motors press and move less, unless they land. None until their temperatures are watched."""
        if self.interface.heat is not None and now >= self._heat_due:
            self._heat_due = now + _HEAT_PERIOD_S
            self._heat = self.interface.heat.check(now, self.chain.temp_mos_c, self.chain.temp_rotor_c)
            if self.gripper is not None:
                self.gripper.derate(float(self._heat.level[-1]))
            if self.landing is None:
                self.setpoint.limit_speed(self.hardware.speed_limit * self._heat.speed_scale)
        return self._heat

    def repeat(self) -> None:
        """Command what went out last, at rest: after a defect of our own code nothing is computed again."""
        self.impedance.commands[:] = self.interface.sent
        self.impedance.commands[:, mit_laws.DQ] = 0.0

    def stop_moving(self) -> None:
        """Brake the set-point and end the search for the gripper's stops."""
        self.setpoint.stop()
        if self.gripper is not None:
            self.gripper.stop_search()

    def hold_here(self) -> None:
        """Brake and hold; an arm that floats keeps its pose."""
        self.setpoint.stop()
        self.enter(Mode.HOLD)

    def switch_off(self) -> None:
        """Cut torque, over the next ticks. Only from a landed pose, or where the arm was limp a moment ago.

        Raises:
            LifeCycleError: not from the present mode.
        """
        self.status.check(Mode.OFF)
        self.status.letting_go = True
        self._off_by_s = self.chain.clock.now() + _OFF_S + 2.0 * self.chain.round_trip.one_way_s

    def let_go(self, now: float) -> None:
        """One tick of it: the arm is off once every motor has said so, or has had the time to."""
        on = np.flatnonzero(self.chain.fault == Fault.NORMAL)
        if len(on) and now < self._off_by_s:
            return
        if len(on):
            names = ", ".join(self.chain.motors[i].name for i in on)
            logger.error("%s: %s did not say that they are off; their watchdogs switch them off", self.name, names)
        self.status.enter(Mode.OFF)
        self.status.letting_go = False
        self.impedance.commands[:] = 0.0
