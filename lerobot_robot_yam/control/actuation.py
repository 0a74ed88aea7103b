"""One arm with all that moves it: motors, set-point, laws, and what each mode makes of them at a tick."""

import logging
import math
from collections.abc import Callable

import can
import numpy as np

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.dynamics import GravityModel
from lerobot_robot_yam.arm.resolved_arm import Hardware
from lerobot_robot_yam.control.impedance import Impedance
from lerobot_robot_yam.control.joint_interface import JointInterface
from lerobot_robot_yam.control.landing import Landing, Phase
from lerobot_robot_yam.control.laws import mit_laws
from lerobot_robot_yam.control.laws.set_point import SetPoint
from lerobot_robot_yam.control.safety.bus_loss import BusLoss
from lerobot_robot_yam.control.safety.channel_monitor import Finding
from lerobot_robot_yam.control.safety.thermal_monitor import Heat
from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.errors import BusError, ChannelInUseError, MotorError
from lerobot_robot_yam.state.faults import SILENT_S, Trouble
from lerobot_robot_yam.state.modes import Mode, check_transition
from lerobot_robot_yam.state.records import Limited

logger = logging.getLogger(__name__)

ACCELERATION_LIMIT_RAD_S2 = 30.0  # brakes from the speed limit within 50 ms
_END_DECELERATION_RAD_S2 = 5.0  # arms overshoot what is harder by centimetres, and joints end on mechanical stops
LEFT_BEHIND_RAD = 0.05  # more than an arm lags with its own gains
_FREE_RAD = 0.1  # farther behind its set-point, and yet faster than this share of its speed limit: it has come free
_FREE_SPEED = 1.1
_JUST_NOW_S = 0.02
_TOLD_AFLOAT = Limited.JOINT_LIMIT | Limited.TORQUE  # as long as it lasts
PRESS_NM = 5.0  # with which a stopped joint presses on: 1 kg at 0.5 m that the model does not know
_TOLD_S = 0.1  # a caller that looks 30 times a second is told
_ENABLE_TICKS = 20  # in which a motor has to say that it is enabled: an answer may get lost
_UNREACHABLE_S = 1.0  # beyond their watchdog, the motors have let go: there is nothing left to land
_GRIPPER_ACCELERATION = 60.0  # strokes/s²
_HEAT_PERIOD_S = 0.1  # metal is slow


class Actuation:
    """Motors, set-point and laws of one arm, in one mode at a time.

    Args:
        config: the arm.
        bus: an open bus; not closed here.
        hardware, gravity: of this very config, if they have been made before.
    """

    def __init__(self, config: ArmConfig, bus: can.BusABC, hardware: Hardware | None, gravity: GravityModel | None):
        self.config = config
        self.name = config.name
        self.hardware = hw = hardware or Hardware(config)
        self.interface = JointInterface(config, hw, bus)
        self.gripper = self.interface.gripper
        self.setpoint = SetPoint(
            hw.speed_limit,
            np.append(np.full(hw.joints, ACCELERATION_LIMIT_RAD_S2), [_GRIPPER_ACCELERATION] * hw.has_gripper),
            hw.lower,
            hw.upper,
            np.append(np.full(hw.joints, _END_DECELERATION_RAD_S2), [_GRIPPER_ACCELERATION] * hw.has_gripper),
        )
        self.mode = Mode.OFFLINE
        self.trouble: Trouble | None = None
        self.message = ""
        self.limited = Limited.NOTHING
        gravity = gravity or gravity_model(hw)
        self.impedance = Impedance(hw, gravity, self.gripper, config.hold_integral, config.float_speed_rad_s)
        self._bad = np.zeros(hw.n, dtype=bool)  # motors that cannot be relied on
        self._usable, self._all_usable = ~self._bad, True
        self._floats = config.start == "float"
        self._landing: Landing | None = None
        self._unreachable_since: float | None = None
        self._bus_loss = BusLoss()
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
        """(n,) as `q`, but a joint whose motor is not heard, and may obey all the same, is where it was sent."""
        return self.q if self._all_usable else np.where(self._unheard(), self.setpoint.q, self.q)

    @property
    def afloat(self) -> bool:
        """Whether only the model carries it."""
        return self.mode is Mode.FLOAT or (self.mode is Mode.STOPPED and self._floats)

    def _check(self, now: float) -> Finding:
        """Which motors can be relied on from here on."""
        finding = self.interface.check(now)
        if finding.bad is not self._bad:  # as long as all are well it is the same array
            for joint in np.flatnonzero(self.chain.distrusted & finding.bad & ~self._bad):
                # Nobody knows any more how far it is from its set-point: it keeps to the last one that was sent.
                if joint < self.hardware.joints:
                    self.setpoint.reseed(int(joint), float(self.interface.sent[joint, mit_laws.Q]))
            self._bad, self._usable = finding.bad, ~finding.bad
            self._all_usable = bool(self._usable.all())
        return finding

    def _unheard(self) -> np.ndarray:
        """(n,) bool, joints that answer no more, or not what can be, and have not said before that they have let go."""
        chain = self.chain
        unheard = ~self._usable & ((chain.silence_s(chain.clock.now()) > SILENT_S) | chain.distrusted)
        unheard &= (chain.fault == Fault.NORMAL) | ~np.isfinite(chain.stamp_s)
        unheard[self.hardware.joints :] = False
        return unheard

    def inspect(self) -> None:
        """Is everything there and as configured? Sends no command that moves or energises anything.

        Raises:
            YamError: names the part that is not.
        """
        self.interface.inspect()

    def energise(self, meanwhile: Callable[[], None] = lambda: None) -> None:
        """Enable the motors, holding the measured pose from the first command on.

        Args:
            meanwhile: called every 20 ms or so.

        Raises:
            ChannelInUseError: somebody else commands these motors; nothing was sent.
            MotorError: a motor does not enable, or somebody else appears meanwhile; those that were enabled are
                disabled again (the arm was limp before).
        """
        check_transition(self.name, self.mode, Mode.BRING_UP)
        self.chain.drain()
        if self.chain.foreign_commands:  # since it was listened to; they hold the arm perhaps
            raise ChannelInUseError(
                f"{self.name}: another driver commands the motors on {self.config.channel}; stop it and try again"
            )
        try:
            self.interface.enable(meanwhile)
            for _ in range(_ENABLE_TICKS):
                meanwhile()
                self.setpoint.seed(self.q)  # as of now: since it was inspected, a hand may have moved a limp arm
                self.command(0.0, 0.0)
                finding = self.interface.exchange(self.impedance.commands)
                self.interface.read()
                if not finding.bad.any():
                    break
            if finding.bad.any():
                raise MotorError(
                    f"{self.name} ({self.config.channel}): cannot enable {finding.message}; "
                    "power-cycle the arm or look at its motors"
                )
            if finding.trouble is not None:  # somebody else is on the channel
                raise MotorError(f"{self.name} ({self.config.channel}): {finding.message}")
        except BaseException:
            self._switch_off()
            raise
        self.mode = Mode.BRING_UP

    def abandon(self) -> None:
        """Cut torque during bring-up: the arm was limp before and has not left its pose."""
        if self.mode not in (Mode.OFF, Mode.OFFLINE):
            self._switch_off()

    def send(self) -> None:
        """Put this tick's commands on the wire.

        Raises:
            BusError: the channel does not take them.
            ActionError: they are not finite.
        """
        self.interface.send(self.impedance.commands)
        self._bus_loss.clear()

    def collect(self, deadline_s: float) -> None:
        """Take the replies of this tick; whatever is missing at the deadline ages."""
        self.interface.chain.collect(deadline_s)

    def command(self, now: float, dt: float) -> None:
        """From state and set-point to the commands of the next `send`."""
        q: np.ndarray = self.interface.motor_q
        dq: np.ndarray = self.interface.motor_dq
        self.impedance.before = self.interface.before
        if not self._all_usable:
            unheard = self._unheard()
            q, dq = np.where(unheard, self.setpoint.q, q), np.where(unheard, self.setpoint.dq, dq)
        if self.afloat:
            self.setpoint.seed(self.here)  # whatever ends the floating finds it where the arm is
            if self.limited:
                self.limited &= ~_TOLD_AFLOAT
            self._tell(self.impedance.float_free(q, dq, dt))
        else:
            self._catch(now)
            fade = None if self._landing is None else self._landing.fade
            learns = self._landing is not None and self._landing.learns
            gripper = float(self.interface.dq[-1]), float(self.interface.tau[-1])
            stopped = self.mode is Mode.STOPPED
            holding = (stopped or self.mode is Mode.HOLD) and self._all_usable
            pressed = self.gripper is not None and self.gripper.force_limited
            self._tell(self.impedance.follow(now, dt, q, dq, self.setpoint, gripper, holding, stopped, learns, fade))
            if pressed and self.gripper is not None and not self.gripper.force_limited:
                # What it has pressed on is gone: from here on at its own speed, not in one leap after the set-point.
                self.setpoint.reseed(self.hardware.n - 1, float(self.q[-1]))
                self._tell(
                    self.impedance.follow(now, 0.0, q, dq, self.setpoint, gripper, holding, stopped, learns, fade)
                )
            if now - self._came_free_s < _TOLD_S:  # a target meanwhile tells anew what limits it
                self.limited |= Limited.CAME_FREE
            elif self._came_free_s > -math.inf:  # while an arm holds, no target comes to take it back
                self.limited &= ~Limited.CAME_FREE
                self._came_free_s = -math.inf

    def _tell(self, limited: Limited) -> None:
        """Add to what is told about the arm. Mostly nothing, and flags take long to combine."""
        if limited:
            self.limited |= limited

    def _catch(self, now: float) -> None:
        """A joint that comes free of what has blocked it must not spring to where its set-point has gone meanwhile."""
        hw = self.hardware
        dq = self.interface.motor_dq[: hw.joints]
        fast = np.abs(dq) > self._free_speed
        if not fast.any() or (self._landing is not None and self._landing.fade is not None):  # nearly always
            return
        gap = (self.setpoint.q - self.interface.motor_q)[: hw.joints]
        age_s = now - self.chain.stamp_s[: hw.joints]
        behind = np.abs(gap) > _FREE_RAD + self._free_speed * age_s  # its set-point has gone on since it was there
        heard = age_s < _JUST_NOW_S + self.chain.round_trip.one_way_s
        for joint in np.flatnonzero(fast & (gap * dq > 0.0) & behind & heard):
            logger.warning("%s: %s came free at %.1f rad/s; caught", self.name, hw.motors[joint].name, dq[joint])
            self.setpoint.fall_back(int(joint), float(self.q[joint]))
            self._came_free_s = now

    def _enter(self, mode: Mode) -> None:
        check_transition(self.name, self.mode, mode)
        if mode is not Mode.TRACK:
            self._use_gains()
        self.mode = mode

    def _use_gains(self, kp: np.ndarray | None = None, kd: np.ndarray | None = None) -> None:
        """Gains (n,) of a target, NaN or None as configured: a softer arm may have been left behind.

        Stiffer ones pull no harder than it was pulled before, but for what an arm lags with its own.
        """
        before = self.impedance.kp
        self.impedance.gains(kp, kd)
        joints = slice(self.hardware.joints)
        gap, kp_before, kp_now = (self.setpoint.q - self.here)[joints], before[joints], self.impedance.kp[joints]
        lags = self.hardware.kp[joints] * LEFT_BEHIND_RAD
        for joint in np.flatnonzero((kp_now > kp_before) & (kp_now * np.abs(gap) > lags)):
            keeps = float(self.q[joint] + gap[joint] * kp_before[joint] / kp_now[joint])
            if kp is None:
                self.setpoint.reseed(int(joint), keeps)
            else:  # its target follows at once
                self.setpoint.shift(int(joint), keeps)

    def _press_less(self) -> None:
        """Who stops everything may be in the arm's way: what is left of its pull carries a load, and hurts nobody."""
        joints = self.hardware.joints
        kp, sag = np.maximum(self.hardware.kp[:joints], 1.0), self.impedance.sag_nm
        here = self.here
        gap = (self.setpoint.q - here)[:joints]
        least = np.minimum(np.maximum(gap, (-PRESS_NM - sag) / kp), (PRESS_NM - sag) / kp)
        for joint in np.flatnonzero(least != gap):
            self.setpoint.reseed(int(joint), float(here[joint] + least[joint]))

    def _seed_joints(self) -> None:
        """Start the joints again from where they are; the gripper's set-point is its grip, and is kept."""
        q = self.here.copy()
        q[self.hardware.joints :] = self.setpoint.q[self.hardware.joints :]
        self.setpoint.seed(q)

    def _derate(self, now: float) -> Heat | None:
        """Warm motors press and move less, but for landing. None while nobody watches their temperatures."""
        if self.interface.heat is not None and now >= self._heat_due:
            self._heat_due = now + _HEAT_PERIOD_S
            self._heat = self.interface.heat.check(now, self.chain.temp_mos_c, self.chain.temp_rotor_c)
            if self.gripper is not None:
                self.gripper.derate(float(self._heat.level[-1]))
            if self._landing is None:
                self.setpoint.speed_limit[:] = self.hardware.speed_limit * self._heat.speed_scale
        return self._heat

    def _repeat(self) -> None:
        """The last commands that went out, at rest: what our own code broke over is not to be computed again."""
        self.impedance.commands[:] = self.interface.sent
        self.impedance.commands[:, mit_laws.DQ] = 0.0

    def _advance_landing(self, now: float) -> None:
        """Move its set-point on; cuts torque where that moves nothing."""
        assert self._landing is not None
        joints = self.hardware.joints
        if self._bus_loss.lost or not self._usable.any():
            self._unreachable_since = self._unreachable_since or now
            if now - self._unreachable_since > _UNREACHABLE_S:
                self.message = self.message or "nothing reaches the arm; its motors have let go by themselves"
                logger.error("%s: cannot be landed: %s", self.name, self.message)
                self._landing, self.mode = None, Mode.OFF
                return
        else:
            self._unreachable_since = None
        before = self._landing.phase
        q, dq, usable = self.q[:joints], self.interface.dq[:joints], self._usable[:joints]
        explained = self.impedance.explains(q, np.where(usable, self.setpoint.q[:joints] - q, 0.0))
        self._landing.advance(q, dq, usable, now, explained)
        if self._landing.phase is Phase.OBSTRUCTED and before is not Phase.OBSTRUCTED:
            self.trouble, self.message = Trouble.OBSTRUCTED, "landing is obstructed; holding"
        if self._landing.phase is Phase.LANDED:
            self._landing = None
            logger.info("%s: landed", self.name)
            self._switch_off()

    def _hold_here(self) -> None:
        """Brake; an arm that floats keeps its pose."""
        self.setpoint.stop()
        self._enter(Mode.HOLD)

    def _switch_off(self) -> None:
        """Cut torque. Only from a landed pose, or where the arm was limp a moment ago."""
        try:
            silent = self.interface.disable()
            if silent:
                names = ", ".join(silent)
                logger.error("%s: %s did not say that they are off; their watchdogs switch them off", self.name, names)
        except BusError as error:
            logger.error("%s: nothing reaches its motors; they let go by themselves: %s", self.name, error)
        self.mode = Mode.OFF
        self.impedance.commands[:] = 0.0


def gravity_model(hardware: Hardware) -> GravityModel | None:
    """Model of an arm; None for a gripper alone."""
    if not hardware.joints:
        return None
    return GravityModel(hardware.arm, hardware.gripper, load=hardware.load, tilt_rad=hardware.tilt_rad)
