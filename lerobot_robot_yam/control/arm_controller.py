"""What an arm is about at each tick: requests, targets, troubles and the emergency stop move it from mode to mode.

No clock and no waiting in here; what each mode does to the motors is in `body`.
"""

import logging
import math

import can
import numpy as np

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.dynamics import GravityModel
from lerobot_robot_yam.arm.resolved_arm import Hardware
from lerobot_robot_yam.control.actuation import LEFT_BEHIND_RAD, Actuation
from lerobot_robot_yam.control.float_monitor import FloatMonitor
from lerobot_robot_yam.control.landing import Landing
from lerobot_robot_yam.control.safety.handle_monitor import HandleMonitor
from lerobot_robot_yam.control.safety.progress_monitor import ProgressMonitor
from lerobot_robot_yam.control.safety.stop_triggers import StopTriggers
from lerobot_robot_yam.control.safety.thermal_monitor import Stage
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.errors import BusError, LifeCycleError, MotorError, YamError
from lerobot_robot_yam.state.faults import RESPONSES, SILENT_S, Response, Trouble
from lerobot_robot_yam.state.modes import ENERGISED, Mode, check_transition
from lerobot_robot_yam.state.records import Limited, Request

logger = logging.getLogger(__name__)

_UNHEARD_S = 0.03  # seven ticks
_END_AGAIN_S = 1.0
_REARM_TICKS = 8  # in which a motor has to say that it is enabled: an answer may get lost
_HELD = (Mode.BRING_UP, Mode.HOLD, Mode.TRACK, Mode.FAULT)
_SEED_RAD = 0.3  # a set-point further than this from the arm is not what holds it
_RELEASE_FIRST = "the emergency stop is latched: look at the arms, then `yam-estop release`"


class ArmController(Actuation):
    """Drives the motors of one channel.

    Bring-up: `inspect` (energises nothing), `energise`, then ticks: `send`, `collect`, `measure`,
    `decide`, (the set-point advances,) `command`.

    Args:
        config: the arm.
        bus: an open bus; the controller does not close it.
        hardware, gravity: of this very config, if they have been made before.
    """

    def __init__(
        self, config: ArmConfig, bus: can.BusABC, hardware: Hardware | None = None, gravity: GravityModel | None = None
    ):
        super().__init__(config, bus, hardware, gravity)
        self._after_search = Mode.FLOAT if self._floats else Mode.HOLD
        self._floating = FloatMonitor(self.interface, self.impedance, self.hardware)
        self._must_land = False  # as soon as the emergency stop is released
        self._end_again_at = -math.inf
        self._halted = False  # by the other arm's trouble
        self._halted_afloat = False
        self.stopped = False  # the emergency stop is latched; to be said before anything is asked or decided
        self._news: Trouble | None = None
        self._held_back = ProgressMonitor(
            self.name, [motor.name for motor in self.hardware.motors[: self.hardware.joints]]
        )
        self._last_target_at = -math.inf
        self._handle_watch = HandleMonitor(self.name, self.interface.encoder)
        self._stop_reasons = StopTriggers(config, self.hardware)
        self.handle = self._handle_watch.read(-math.inf)  # trigger, buttons, stamp

    def adopt(self, record: np.ndarray, now: float) -> None:
        """Take over from a loop that has died, and land. `record`: the state that it has published last.

        An arm of which no motor is enabled is left alone.
        """
        self.interface.adopt(record)
        self._check(now)
        if np.isfinite(self.chain.stamp_s).all() and not self._usable.any():  # all have answered
            self.mode = Mode.OFF
            return
        slots = self.hardware.slots
        before = record["setpoint"][slots]
        holds_it = np.abs(before - self.q) < (_SEED_RAD if record["own_gains"] else LEFT_BEHIND_RAD)
        unheard = record["stamp_s"] - record["motor_stamp_s"][slots] > SILENT_S  # but perhaps it obeys
        holds_it |= unheard & (record["fault"][slots] == Fault.NORMAL) & ~np.isfinite(self.chain.stamp_s)
        holds_it[self.hardware.joints :] = np.isfinite(before[self.hardware.joints :])  # its grip, however thick
        self.setpoint.seed(np.where(holds_it, before, self.q))
        self.land(now, Trouble.CONTROL_DEAD, "its control process has died; the stand-by lands it")
        self.command(now, 0.0)  # or the first tick would send zeros

    def measure(self, now: float) -> None:
        """From the replies to the state of the arm; trouble is answered as the policy says."""
        self.interface.read()
        self.handle = self._handle_watch.read(now)
        if self.mode in (Mode.OFF, Mode.OFFLINE):
            return
        finding = self._check(now)
        if finding.trouble is not None and self.mode not in (Mode.FAULT, Mode.LAND):
            self._suffer(finding.trouble, finding.message, now)
        heat = self._derate(now)
        if heat is not None and heat.stage:
            self.limited |= Limited.HEAT
            if heat.stage is Stage.HOT and self.mode is Mode.FAULT:
                self.end(now)  # while the others of its motors still obey
            elif heat.stage is Stage.HOT and self.mode is not Mode.LAND and not self._must_land:
                self._suffer(Trouble.HOT, heat.message, now)

    def stop_reason(self, now: float) -> str:
        """Why everything has to stop, empty when it has not: the handle's button, or too much effort."""
        tau = self.interface.tau[: self.hardware.joints]
        works = self.mode in ENERGISED and self.mode not in (Mode.STOPPED, Mode.FAULT)
        return self._stop_reasons.check(now, self.handle[1], tau, works)

    def decide(self, now: float) -> None:
        """What the arm is about. Its set-point is then to be advanced."""
        if self.stopped:
            self._stop()
        elif self.mode is Mode.STOPPED:
            self._resume(now)
        wrong = self._floating.watch(now, self.mode in _HELD and self._all_usable, self.afloat)
        if wrong:
            self._floating.brake(self.setpoint)
            self._suffer(Trouble.RUNAWAY, wrong, now)
        if self.mode is Mode.BRING_UP:
            self._bring_up(now)
        if self.mode is Mode.TRACK and now - self._last_target_at > self.config.command_timeout_s:
            self.limited |= Limited.COMMAND_TIMEOUT
            logger.warning("%s: no target for %g s; it holds", self.name, self.config.command_timeout_s)
            self.setpoint.stop()
            self._enter(Mode.HOLD)
        if self.mode is Mode.TRACK and now - self._heard_s() > _UNHEARD_S + self.chain.round_trip.one_way_s:
            self.setpoint.stop()  # or it would run ahead of an arm that does not hear, which would then hurry after it
        if self._landing is not None:
            self._advance_landing(now)
        elif self.mode in (Mode.HOLD, Mode.TRACK):
            j = slice(self.hardware.joints)
            gap = (self.setpoint.q - self.here)[j]
            self._held_back.by_obstacle(now, gap, self.impedance.kp[j], self.hardware.torque_limit_nm[j])

    def _heard_s(self) -> float:
        """When the motor that has been silent for longest has answered, but for those that are lost."""
        stamps = self.chain.stamp_s if self._all_usable else self.chain.stamp_s[self._usable]
        return min(stamps.tolist(), default=math.inf)

    def aim(
        self,
        target: np.ndarray,
        now: float,
        velocity: np.ndarray | None = None,
        kp: np.ndarray | None = None,
        kd: np.ndarray | None = None,
    ) -> bool:
        """A new target (n,), gripper 0 … 1; taken while holding or tracking only. True when taken."""
        if self.mode not in (Mode.HOLD, Mode.TRACK) or self._halted:
            return False
        self._last_target_at = now
        self._use_gains(kp, kd)
        gap = float(np.abs(target - self.setpoint.q)[: self.hardware.joints].max(initial=0.0))
        self.limited = Limited.SPEED if self._held_back.by_speed(gap) else Limited.NOTHING
        self.setpoint.aim(target, now, velocity)
        if self.mode is Mode.HOLD:
            self._enter(Mode.TRACK)
        return True

    def request(self, request: Request, now: float) -> None:
        """Change mode as the caller asks.

        Raises:
            YamError: not from the present mode, or it cannot be done.
        """
        if request is Request.LAND:
            if self.mode is Mode.FAULT and self.stopped:
                raise LifeCycleError(f"{self.name}: {self.message}; {_RELEASE_FIRST}")
            self.land(now)
        elif request is Request.REARM:
            self._rearm()
        elif self.mode is Mode.FAULT:
            raise LifeCycleError(f"{self.name}: {self.message}; re-arm it first")
        elif request is Request.HOLD:
            if self.mode is Mode.BRING_UP:
                self._after_search = Mode.HOLD
            elif self.mode not in (Mode.HOLD, Mode.STOPPED):
                check_transition(self.name, self.mode, Mode.HOLD)
                self._hold_here()
        elif request is Request.FLOAT:
            if self.mode is Mode.BRING_UP:
                self._after_search = Mode.FLOAT
            elif self.mode not in (Mode.FLOAT, Mode.STOPPED):
                self._floating.check(self.name)
                self._enter(Mode.FLOAT)
        elif request is Request.CALIBRATE_GRIPPER:
            if self.gripper is None:
                raise MotorError(f"{self.name}: {self.hardware.gripper.name} has no motor to calibrate")
            if self.stopped:
                raise LifeCycleError(f"{self.name}: the fingers keep what they hold; {_RELEASE_FIRST}")
            before = Mode.FLOAT if self.mode is Mode.FLOAT else Mode.HOLD
            self._enter(Mode.BRING_UP)
            self._after_search = before
            self.setpoint.stop()
            self.gripper.begin(calibrate=True)

    def land(self, now: float, trouble: Trouble | None = None, message: str = "") -> None:
        """Begin to land; does nothing when landing or off already, and waits for the end of an emergency stop."""
        if self.mode in (Mode.LAND, Mode.OFF):
            return
        if self.mode is Mode.OFFLINE and trouble is None:
            self.mode = Mode.OFF
            return
        self.trouble, self.message = trouble, message
        if self.mode is Mode.STOPPED:
            self._must_land = True
            return
        self._enter(Mode.LAND)
        if self.gripper is not None:
            self.gripper.stop_search()
        if self.hardware.joints:
            hw, q = self.hardware, self.q[: self.hardware.joints]
            self._landing = Landing(self.name, hw.rest_q, hw.kp, q, self.setpoint, now, hw.folding, hw.lies_at_rest)
        else:
            self._switch_off()  # a gripper alone falls nowhere

    def end(self, now: float) -> None:
        """Land because nobody is there any more. Ask every tick: what faults on its way tries again."""
        if now < self._end_again_at or (self.mode is Mode.FAULT and self.stopped):
            return
        self._end_again_at = now + _END_AGAIN_S
        self.land(now, self.trouble, self.message)

    def _suffer(self, trouble: Trouble, message: str, now: float) -> None:
        """Answer trouble as the policy says, and have the other arms told."""
        logger.error("%s (%s): %s: %s", self.name, self.config.channel, trouble, message)
        self._news = trouble
        if RESPONSES[trouble].arm is Response.LAND:
            self.land(now, trouble, message)
            return
        self.trouble, self.message = trouble, message
        self._must_land = False
        self.setpoint.stop()
        if self.gripper is not None:
            self.gripper.stop_search()
        self._enter(Mode.FAULT)

    def held_back(self, by: str) -> None:
        """The workspace holds the set-point back, `by` names the parts; empty when it does not."""
        if self._held_back.by_workspace(by):
            self.limited |= Limited.WORKSPACE

    def take_news(self) -> Trouble | None:
        """Trouble that has come up since the last call."""
        news, self._news = self._news, None
        return news

    def halt(self, why: str) -> None:
        """The other arm is in trouble: hold, and take no targets until re-armed."""
        if self.mode in (Mode.HOLD, Mode.TRACK, Mode.FLOAT, Mode.STOPPED, Mode.BRING_UP):
            logger.warning("%s: holds: %s", self.name, why)
            self._halted_afloat |= self._floats and self.mode in (Mode.FLOAT, Mode.STOPPED)
            self._halted = True
            self.limited |= Limited.PEER
            if self.mode in (Mode.TRACK, Mode.FLOAT):
                self._hold_here()

    def lose_bus(self, error: BusError, now: float) -> None:
        """The channel takes nothing: the motors keep the last command until their own watchdogs act."""
        trouble = self._bus_loss.note(error, now)
        if trouble is not None and self.mode not in (Mode.FAULT, Mode.LAND):
            self._suffer(trouble, str(error), now)

    def fail(self, error: Exception) -> None:
        """Something in our own code broke: the last commands that went out hold the arm, at rest."""
        if self.mode is not Mode.FAULT:
            logger.critical("%s: internal error, holding", self.name, exc_info=error)
            self.trouble, self.message = Trouble.INTERNAL_ERROR, f"internal error, holding: {error!r}"
            self._news = self.trouble
            self.mode = Mode.FAULT
            self.setpoint.stop()
            self._use_gains()
            if self.gripper is not None:
                self.gripper.stop_search()
        self._landing = None
        self._repeat()

    def _rearm(self) -> None:
        """Enable again what has failed, and hold the measured pose. Blocks for some ticks.

        Raises:
            MotorError: a motor still does not obey; those that do again hold where they are.
            LifeCycleError: this trouble needs a new connection.
        """
        if self.mode is Mode.LAND or self._must_land:
            why = self.message or "it has been told to land"
            raise LifeCycleError(f"{self.name}: {why}; let it land, then connect again")
        if self.mode is Mode.FAULT:
            assert self.trouble is not None
            if self.stopped:
                raise LifeCycleError(f"{self.name}: {self.message}; {_RELEASE_FIRST}")
            if not RESPONSES[self.trouble].in_place:
                raise LifeCycleError(f"{self.name}: {self.message}; {RESPONSES[self.trouble].rearm}")
            if self._floats:
                self._floating.check(self.name)
            failed = np.flatnonzero(~self._usable).tolist()
            again = self.interface.clear_and_enable(failed)
            before = self.setpoint.q.copy()
            self._seed_joints()
            before[again] = self.setpoint.q[again]  # they have sagged meanwhile
            for joint in set(failed) - set(again):  # nobody knows where it is; perhaps it still holds
                self.setpoint.reseed(joint, before[joint])
            self.command(self.chain.clock.now(), 0.0)
            for _ in range(_REARM_TICKS):
                finding = self.interface.exchange(self.impedance.commands)
                if finding.trouble is None:
                    break
            if finding.trouble is not None:
                self.setpoint.seed(before)
                raise MotorError(f"{self.name} ({self.config.channel}): cannot re-arm: {finding.message}")
            if self.gripper is not None and (self.hardware.n - 1 in failed or self.gripper.stops is None):
                self._after_search = Mode.HOLD
                self.gripper.begin()
                self._enter(Mode.BRING_UP)
            else:
                self._enter(Mode.FLOAT if self._floats else Mode.HOLD)
        if self._halted_afloat and self.mode is Mode.HOLD:
            self._floating.check(self.name)
            self._enter(Mode.FLOAT)
        logger.warning("%s: re-armed", self.name)
        self._halted = self._halted_afloat = False
        self.trouble, self.message, self.limited = None, "", Limited.NOTHING

    def _stop(self) -> None:
        """The emergency stop is latched."""
        latched_now = not self.limited & Limited.EMERGENCY_STOP
        self.limited |= Limited.EMERGENCY_STOP
        if self.mode is Mode.FAULT and latched_now:
            self._press_less()
        if self.mode in (Mode.STOPPED, Mode.FAULT, Mode.OFF, Mode.OFFLINE):
            return
        if self.mode is Mode.LAND:
            self._landing, self._must_land = None, True
        self.setpoint.stop()
        if self.gripper is not None:
            self.gripper.stop_search()
        self._enter(Mode.STOPPED)
        self._press_less()

    def _resume(self, now: float) -> None:
        """The emergency stop has been released: from the measured pose."""
        self.limited &= ~Limited.EMERGENCY_STOP
        self._seed_joints()
        if self.gripper is not None and self.gripper.stops is None and not self._must_land:
            try:
                self.gripper.begin()
            except YamError as error:
                self._suffer(Trouble.GRIPPER, str(error), now)
                return
            self._enter(Mode.BRING_UP)
            return
        floats = self._floats and not (self._must_land or self._halted)
        self._enter(Mode.FLOAT if floats else Mode.HOLD)
        if self._must_land:
            self._must_land = False
            self.land(now, self.trouble, self.message)

    def _bring_up(self, now: float) -> None:
        """Leave bring-up once the gripper's stops are known."""
        if self.gripper is not None and self.gripper.searching:
            try:
                shift = self.gripper.advance(now, float(self.interface.motor_q[-1]))
            except YamError as error:
                self._suffer(Trouble.GRIPPER, str(error), now)
                return
            if shift is None:
                return
            self.interface.shift_gripper(shift)
            self.setpoint.reseed(self.hardware.n - 1, float(self.q[-1]))
        after = Mode.HOLD if self._halted else self._after_search
        if after is Mode.FLOAT:
            wrong = self._floating.settled()
            if wrong is None:
                return
            if wrong:
                self._suffer(Trouble.WEIGHT, f"{self.name} does not float: {wrong}", now)
                return
        self._enter(after)
