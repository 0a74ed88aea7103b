"""The actuation of one arm: its motors, set-point and laws, and the commands that each mode makes of them."""

import logging
import math

import can
import numpy as np

from lerobot_robot_yam.arm.dynamics import GravityModel
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.arm_status import ArmStatus
from lerobot_robot_yam.control.impedance import Grip, Impedance
from lerobot_robot_yam.control.joint_interface import JointInterface
from lerobot_robot_yam.control.landing.landing import Landing
from lerobot_robot_yam.control.laws import mit_laws
from lerobot_robot_yam.control.laws.set_point import SetPoint
from lerobot_robot_yam.control.safety.channel_monitor import BusLoss, Finding
from lerobot_robot_yam.control.safety.thermal_monitor import Heat
from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.errors import BusError
from lerobot_robot_yam.state.faults import SILENT_S
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Limited
from lerobot_robot_yam.system.few_values import any_of

logger = logging.getLogger(__name__)

ACCELERATION_LIMIT_RAD_S2 = 30.0  # brakes from the speed limit within 50 ms
_END_DECELERATION_RAD_S2 = 5.0  # an arm overshoots a harder stop by centimetres, and joints end on mechanical stops
LEFT_BEHIND_RAD = 0.05  # more than an arm lags with its own gains
_FREE_RAD = 0.1  # a joint this far behind its set-point, and
_FREE_SPEED = 1.1  # faster than this share of its speed limit, has come free
_JUST_NOW_S = 0.02
_GOES_ON = (Mode.BRING_UP, Mode.HOLD, Mode.TRACK)  # and carries no more what a landing has found there
_TOLD_AFLOAT = Limited.JOINT_LIMIT | Limited.TORQUE  # told as long as it lasts
_TOLD_S = 0.1  # a caller that looks 30 times a second sees it
_GRIPPER_ACCELERATION = 60.0  # strokes/s²
_HEAT_PERIOD_S = 0.1  # temperatures change slowly


class Actuation:
    """Motors, set-point and laws of one arm.

    Args:
        hardware: the arm.
        bus: an open bus; not closed here.
        status: of the arm.
        gravity: its model, if that has been made before.

    Attributes:
        landing: the landing under way; `landing_response` owns it.
        grips: while it floats its gripper keeps to the set-point: a hand guides it.
        assist: torque and damping (joints,) that act beside its weight while it floats; None: none.
        usable, all_usable: (n,) bool, motors that can be relied on, and whether all can.
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
        self.gripper = self.interface.gripper
        self.setpoint = SetPoint(
            hw.speed_limit,
            np.append(np.full(hw.joints, ACCELERATION_LIMIT_RAD_S2), [_GRIPPER_ACCELERATION] * hw.has_gripper),
            hw.lower,
            hw.upper,
            np.append(np.full(hw.joints, _END_DECELERATION_RAD_S2), [_GRIPPER_ACCELERATION] * hw.has_gripper),
        )
        self.impedance = Impedance(hw, gravity or gravity_model(hw), self.gripper)
        self._bad = np.zeros(hw.n, dtype=bool)
        self.usable, self.all_usable = ~self._bad, True
        self.landing: Landing | None = None
        self._sunk = np.zeros(hw.joints, dtype=bool)
        self.grips = False
        self.assist: tuple[np.ndarray, np.ndarray] | None = None
        self.bus_loss = BusLoss()
        self._heat: Heat | None = None
        self._heat_due = -math.inf
        self._came_free_s = -math.inf
        self._free_speed = _FREE_SPEED * hw.speed_limit[: hw.joints]

    @property
    def chain(self) -> MotorChain:
        """The motors."""
        return self.interface.chain

    @property
    def q(self) -> np.ndarray:
        """(n,) measured, rad; the gripper 0 closed … 1 open."""
        return self.interface.q

    @property
    def here(self) -> np.ndarray:
        """(n,) as `q`, but a joint that is not heard, and may obey all the same, is where it was sent."""
        return self.q if self.all_usable else np.where(self._unheard(), self.setpoint.q, self.q)

    @property
    def sunk(self) -> np.ndarray:
        """(joints,) bool, joints that a landing has let sink unheard: they have left their set-points.

        Until they are heard again they only get damping.
        """
        return self._sunk if self.landing is None else self._sunk | self.landing.sunk

    @property
    def pulls(self) -> np.ndarray:
        """(joints,) the way, -1 or 1, in which its weight pulls a joint that is not heard and may obey; else 0."""
        weight_nm, j = self.impedance.weight_nm, slice(self.hardware.joints)
        carried = self._unheard()[j] & ~self._sunk & (np.abs(weight_nm) > self.hardware.arm.coulomb_friction_nm)
        return np.where(carried, -np.sign(weight_nm), 0.0)

    def adopt(self, sunk: np.ndarray) -> None:
        """Go on for a loop that has died, and that has let these joints sink, (joints,) bool."""
        self._sunk = sunk

    def end_landing(self) -> None:
        """Land no more; what has sunk stays so."""
        self._sunk, self.landing = self.sunk, None
        self.setpoint.limit_acceleration(np.full(self.hardware.joints, ACCELERATION_LIMIT_RAD_S2))

    def check(self, now: float) -> Finding:
        """Find out which motors can be relied on from here on."""
        finding = self.interface.check(now)
        if finding.bad is not self._bad:  # as long as all are well it is the same array
            for joint in np.flatnonzero(self.chain.distrusted & finding.bad & ~self._bad):
                # Nobody knows any more how far it is from its set-point: it keeps to the last one that was sent.
                if joint < self.hardware.joints:
                    self.setpoint.reseed(int(joint), float(self.interface.sent[joint, mit_laws.Q]))
            self._bad, self.usable = finding.bad, ~finding.bad
            self.all_usable = bool(self.usable.all())
        if any_of(self._sunk):  # hardly ever
            heard = self._sunk & (self.usable & np.isfinite(self.chain.stamp_s))[: self.hardware.joints]
            start = self.setpoint.reseed if self.landing is None else self.setpoint.fall_back
            for joint in np.flatnonzero(heard):
                start(int(joint), float(self.q[joint]))
            self._sunk = self._sunk & ~heard
        return finding

    def _unheard(self) -> np.ndarray:
        """(n,) bool, joints whose motors are silent or distrusted, and have not said before that they let go."""
        chain = self.chain
        unheard = ~self.usable & ((chain.silence_s(chain.clock.now()) > SILENT_S) | chain.distrusted)
        unheard &= (chain.fault == Fault.NORMAL) | ~np.isfinite(chain.stamp_s)
        unheard[self.hardware.joints :] = False
        return unheard

    def send(self) -> None:
        """Put this tick's commands on the wire.

        Raises:
            BusError: the channel does not take them.
            ActionError: they are not finite.
        """
        self.interface.send(self.impedance.commands)
        self.bus_loss.clear()

    def compute_command(self, now: float, dt: float) -> None:
        """From state and set-point to the commands of the next `send`. now, dt: s."""
        self._compute_command(now, dt)
        if any_of(self._sunk):
            self.impedance.sink(self._sunk)

    def _compute_command(self, now: float, dt: float) -> None:
        q: np.ndarray = self.interface.motor_q
        dq: np.ndarray = self.interface.motor_dq
        self.impedance.before = self.interface.before
        if not self.all_usable:
            unheard = self._unheard()
            q, dq = np.where(unheard, self.setpoint.q, q), np.where(unheard, self.setpoint.dq, dq)
        status = self.status
        gripper = float(self.interface.dq[-1]), float(self.interface.tau[-1])
        pressed = self.gripper is not None and self.gripper.force_limited
        if status.afloat:
            # Whatever ends the floating finds the set-point where the arm is.
            if self.grips:
                self.setpoint.seed_first(self.here[: self.hardware.joints])
            else:
                self.setpoint.seed(self.here)
            if status.limited:
                status.limited &= ~_TOLD_AFLOAT
            assist = self.assist if status.mode is Mode.FLOAT and self.all_usable else None
            grip = Grip(now, self.setpoint, gripper) if self.grips else None
            self._tell(self.impedance.float_free(q, dq, dt, assist, grip))
            if self.grips and pressed and self.gripper is not None and not self.gripper.force_limited:
                self.setpoint.reseed(self.hardware.n - 1, float(self.q[-1]))  # its object is gone, see below
            return
        self._catch(now)
        fade = None if self.landing is None else self.landing.fade
        learns = None if status.mode in _GOES_ON else self.landing is not None and self.landing.learns
        stopped = status.mode is Mode.STOPPED
        tracks = self.config.track_integral and status.mode is Mode.TRACK
        holding = (stopped or tracks or status.mode is Mode.HOLD) and self.all_usable
        self._tell(self.impedance.follow(now, dt, q, dq, self.setpoint, gripper, holding, stopped, learns, fade))
        if pressed and self.gripper is not None and not self.gripper.force_limited:
            # The object that it pressed on is gone: it goes on at its own speed, not in one leap after the set-point.
            self.setpoint.reseed(self.hardware.n - 1, float(self.q[-1]))
            self._tell(self.impedance.follow(now, 0.0, q, dq, self.setpoint, gripper, holding, stopped, learns, fade))
        if now - self._came_free_s < _TOLD_S:  # each new target tells anew what limits the arm
            status.limited |= Limited.CAME_FREE
        elif self._came_free_s > -math.inf:  # while an arm holds, no target comes to take it back
            status.limited &= ~Limited.CAME_FREE
            self._came_free_s = -math.inf

    def _tell(self, limited: Limited) -> None:
        """Add to what is told about the arm. Mostly nothing, and flags take long to combine."""
        if limited:
            self.status.limited |= limited

    def _catch(self, now: float) -> None:
        """Stop a joint that comes free of an obstacle: it must not spring to where its set-point has gone."""
        hw = self.hardware
        dq = self.interface.motor_dq[: hw.joints]
        fast = np.abs(dq) > self._free_speed
        if not any_of(fast) or (self.landing is not None and self.landing.fade is not None):  # nearly always
            return
        gap = (self.setpoint.q - self.interface.motor_q)[: hw.joints]
        age_s = now - self.chain.stamp_s[: hw.joints]
        behind = np.abs(gap) > _FREE_RAD + self._free_speed * age_s  # its set-point has gone on since the sample
        heard = self.usable[: hw.joints] & (age_s < _JUST_NOW_S + self.chain.round_trip.one_way_s)  # and not limp
        for joint in np.flatnonzero(fast & (gap * dq > 0.0) & behind & heard):
            logger.info("%s: %s came free at %.1f rad/s; caught", self.name, hw.motors[joint].name, dq[joint])
            self.setpoint.fall_back(int(joint), float(self.q[joint]))
            self._came_free_s = now

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
        self._pull_no_harder(before, self.impedance.kp, kp is not None)

    def change_gains(self, kp: np.ndarray, kd: np.ndarray) -> None:
        """Go over to other gains (n,) of its own, NaN as configured, so that no torque jumps; targets keep theirs."""
        self._pull_no_harder(self.impedance.kp, np.where(np.isnan(kp), self.hardware.kp, kp), False)
        self.impedance.live.change(kp, kd)

    def _pull_no_harder(self, before: np.ndarray, now: np.ndarray, target_follows: bool) -> None:
        """Bring the set-point of a joint back whose stiffness (n,) grows far from it."""
        joints = slice(self.hardware.joints)
        gap, kp_before, kp_now = (self.setpoint.q - self.here)[joints], before[joints], now[joints]
        lags = self.hardware.kp[joints] * LEFT_BEHIND_RAD
        for joint in np.flatnonzero((kp_now > kp_before) & (kp_now * np.abs(gap) > lags)):
            keeps = float(self.q[joint] + gap[joint] * kp_before[joint] / kp_now[joint])
            if target_follows:  # at once
                self.setpoint.shift(int(joint), keeps)
            else:
                self.setpoint.reseed(int(joint), keeps)

    def seed_joints(self) -> None:
        """Start the joints again from where they are; the gripper's set-point is its grip, and is kept."""
        q = self.here.copy()
        q[self.hardware.joints :] = self.setpoint.q[self.hardware.joints :]
        self.setpoint.seed(q)

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
        """Cut torque. Only from a landed pose, or where the arm was limp a moment ago.

        Raises:
            LifeCycleError: not from the present mode.
        """
        self.status.check(Mode.OFF)
        try:
            silent = self.interface.disable()
            if silent:
                names = ", ".join(silent)
                logger.error("%s: %s did not say that they are off; their watchdogs switch them off", self.name, names)
        except BusError as error:
            logger.error("%s: nothing reaches its motors; they let go by themselves: %s", self.name, error)
        self.status.enter(Mode.OFF)
        self.impedance.commands[:] = 0.0


def gravity_model(hardware: ResolvedArm) -> GravityModel | None:
    """Model of an arm; None for a gripper alone."""
    if not hardware.joints:
        return None
    return GravityModel(hardware.arm, hardware.gripper, load=hardware.load, tilt_rad=hardware.tilt_rad)
