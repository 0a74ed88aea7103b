"""The controller of a mobile base: requests, targets, faults and the emergency stop move it from mode to mode.

HOLD commands velocity 0, so that the base stays on a slope. TRACK follows targets; a target that is too old is followed
by planned braking to rest. STOPPED and FAULT brake with the hard cap of acceleration. LAND brakes as usual, hard
if that takes too long, and then cuts torque. A rail, if there is one, decides by the same modes.
"""

import logging
import math
from collections.abc import Callable, Iterator
from statistics import median

import can
import numpy as np

from lerobot_robot_yam.control.arm_status import ArmStatus
from lerobot_robot_yam.control.mobile.base_monitor import BaseHeat, StallMonitor
from lerobot_robot_yam.control.mobile.base_motors import CASTER_MOTORS, STEER, BaseMotors
from lerobot_robot_yam.control.mobile.base_steps import BaseExit, BaseRearm
from lerobot_robot_yam.control.mobile.rail_controller import RailController
from lerobot_robot_yam.control.mobile.rail_monitor import Finding
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.errors import BusError, LifeCycleError
from lerobot_robot_yam.mobile.base_motion import BaseMotion
from lerobot_robot_yam.mobile.base_target import REST, Frame, Target
from lerobot_robot_yam.mobile.rail_profile import RailTarget
from lerobot_robot_yam.mobile.resolved_base import ResolvedBase
from lerobot_robot_yam.state.base_records import BaseRequest
from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Limited

logger = logging.getLogger(__name__)

_REST = np.array([0.005, 0.005, 0.01])  # velocities below which the base counts as at rest, m/s, m/s, rad/s
_SETTLE_S = 0.3  # rest at velocity 0 before torque is cut, s: a chassis that was braked hard still rocks
_BRAKE_S = 4.0  # time of braking as usual before torque is cut, s: enough for the default limits; then it brakes hard
_HARD_BRAKE_S = 2.0  # maximum time of braking hard, s: from the highest speed it takes 1.25 s


class BaseController:
    """Controller of one base's motors.

    Args:
        hardware: the base.
        bus: an open bus; the controller does not close it.

    Attributes:
        motion: plan and odometry.
        peers: statuses of the other parts of the robot; the base keeps its torque until they are off.
        motors: the motors. rail: the rail, None without one.
    """

    def __init__(self, hardware: ResolvedBase, bus: can.BusABC):
        self.hardware, self.config, self.name = hardware, hardware.config, hardware.name
        self.status = ArmStatus(self.name, floats=False)
        self.motors = BaseMotors(hardware, bus)
        self.chain = self.motors.chain
        self.clock, self.wire_s = self.chain.clock, self.chain.expected_wire_s
        self.start_send, self.start_receive = self.motors.send, self.motors.receive
        self.complaints = self.motors.complaints
        self.motion = BaseMotion(hardware.profile, hardware.limits)
        self.rail = None if hardware.config.rail is None else RailController(hardware, self.motors)
        self._stalls, self._heat = StallMonitor(hardware), BaseHeat(self.name, self.chain)
        self._target, self._target_s = REST, -math.inf
        self._measured_s = math.nan  # time of the samples that the odometry took last
        self._rests_s = math.inf  # time since which a landing base is at rest
        self._until_s = math.inf  # when braking as usual ends at the latest
        self._rearm = BaseRearm(self.status, self.motors, self._restart)
        self._exit = BaseExit(self.status, self.motors, self.rail)
        self.peers: list[ArmStatus] = []  # the other parts of the robot
        self._news: Trouble | None = None

    @property
    def mode(self) -> Mode:
        return self.status.mode

    @property
    def lost(self) -> int:
        return int(self.chain.lost.sum())

    def inspect(self) -> None:
        """Check that everything is there and as configured; see `BaseMotors.inspect`."""
        self.motors.inspect()
        self._heat.inspect()
        if self.rail is not None:
            self.rail.inspect()

    def close(self) -> None:
        if self.rail is not None:
            self.rail.close()

    def energise(self) -> Iterator[None]:
        """Enable the motors, one step per tick, at velocity 0.

        Raises:
            ChannelInUseError: another driver commands these motors; nothing was sent.
            MotorError: a motor does not enable.
        """
        self.motors.check_alone()
        self.status.enter(Mode.BRING_UP)
        yield from self.motors.enable(range(self.hardware.n))

    def abandon(self) -> None:
        if not self.status.ended:
            self._switch_off()

    def adopt(self, record: np.ndarray, now: float) -> None:
        """Take over from a loop that has died: brake, then cut torque. `record`: the last state that it published."""
        try:
            self.motors.adopt(record)
        except BusError as error:  # the brake of the rail has to be engaged all the same
            logger.critical("%s: %s", self.name, error)
        if self.rail is not None:
            self.rail.adopt(record)
        if np.isfinite(self.chain.stamp_s).all() and not (self.chain.fault == Fault.NORMAL).any():
            self.status.enter(Mode.OFF)
            return
        self.motion.odometry.pose = record["pose"].copy()
        self.motion.velocity = record["planned"].copy()
        self._land(now, Trouble.CONTROL_DEAD, "its control process has died; the stand-by brakes it")
        self.advance(now, 1.0 / self.config.rate_hz)

    def send(self) -> None:
        self._talk(self.motors.send)

    def drain(self) -> None:
        self._talk(self.chain.drain)

    def collect(self, until_s: float) -> None:
        self._talk(lambda: self.chain.collect(until_s))

    def _talk(self, work: Callable[[], object]) -> None:
        """Run `work`, which sends or receives frames; respond to a lost channel."""
        try:
            work()
        except BusError as error:
            trouble = self.motors.loss.note(error, self.clock.now())
            if trouble is not None:
                self._suffer(trouble, str(error))
        except Exception as error:  # other parts of the robot must be commanded all the same
            self.fail(error)

    def measure(self, now: float) -> None:
        """Update state and odometry from the replies; respond to faults as the table in `state.faults` says."""
        self.motors.read()
        rail = None if self.rail is None else self.rail.measure(now)
        if self.status.letting_go:
            self._heed(self._exit.advance())
            return
        self._measure_way()
        channel = self.motors.watch.check(now)
        if channel.trouble is not None:
            self._suffer(channel.trouble, channel.message)
            return
        stalled = self._stalls.check(now, self.motors.asked[CASTER_MOTORS], self.motors.dq[CASTER_MOTORS])
        finding = rail or self._heat.check(now) or stalled
        if finding is not None:
            self._suffer(*finding)

    def _measure_way(self) -> None:
        """Integrate the odometry over the time between the samples, not over the nominal period."""
        stamp_s = median(self.chain.stamp_s[CASTER_MOTORS].tolist())
        dt, self._measured_s = stamp_s - self._measured_s, stamp_s
        if 0.0 < dt < math.inf:  # False for NaN
            self.motion.measure(self.motors.q[STEER], self.motors.dq[CASTER_MOTORS], dt)

    def stop_reason(self, now: float) -> str:
        return ""

    def decide(self, now: float) -> None:
        """Decide on the mode and on the target of the plan."""
        status = self.status
        if status.letting_go:
            return
        if status.stopped:
            if status.mode not in (Mode.STOPPED, Mode.FAULT) and not status.ended:
                status.must_land |= status.mode is Mode.LAND
                self._rest(Mode.STOPPED)
            status.limited |= Limited.EMERGENCY_STOP
        elif status.mode is Mode.STOPPED:
            status.limited &= ~Limited.EMERGENCY_STOP
            status.enter(Mode.HOLD)
            if status.must_land:
                status.must_land = False
                self._land(now, status.trouble, status.message)
        self._rearm.advance()
        if status.mode is Mode.BRING_UP:
            if self.rail is None or self.rail.is_up(now):
                status.enter(Mode.HOLD)
        elif status.mode is Mode.TRACK and now - self._target_s > self.config.command_timeout_s:
            self._target = REST
            if self.rail is None or now - self.rail.target_s > self.config.command_timeout_s:
                status.limited |= Limited.COMMAND_TIMEOUT
                logger.info("%s: no target for %g s; it brakes", self.name, self.config.command_timeout_s)
                self._rest(Mode.HOLD)
        elif status.mode is Mode.LAND and all(peer.ended for peer in self.peers):
            self._rests_s = min(self._rests_s, now) if self._at_rest() else math.inf
            if now - self._rests_s > _SETTLE_S or now > self._until_s + _HARD_BRAKE_S:
                self._switch_off()

    def set_target(self, target: Target | RailTarget, now: float, age_s: float) -> bool:
        """Accept a target given `age_s` ago, if the base holds or tracks; return whether it does."""
        status = self.status
        homing = self.rail is not None and self.rail.homing
        fresh = age_s <= self.config.command_timeout_s  # False for NaN
        if status.mode not in (Mode.HOLD, Mode.TRACK) or status.halted or homing or not fresh:
            return False
        if isinstance(target, Target):
            self._target, self._target_s = target, now - age_s
        elif self.rail is not None:
            self.rail.set_target(target, now - age_s)
        status.limited = Limited.NOTHING
        if status.mode is Mode.HOLD:
            status.enter(Mode.TRACK)
        return True

    def advance(self, now: float, dt: float) -> None:
        """Plan one tick, and set the rates of the casters."""
        mode = self.status.mode
        hard = mode in (Mode.STOPPED, Mode.FAULT) or (mode is Mode.LAND and now > self._until_s)
        if dt <= 0.0:
            return
        share = 1.0 if self.rail is None else self.rail.advance(now, dt, mode)
        rates = self.motion.advance(self._target, self.motors.q[STEER], dt, share * self._heat.share, hard)
        if self.motion.slowed < 1.0:
            self.status.limited |= Limited.SPEED
        self.motors.asked[CASTER_MOTORS] = rates

    def compute_command(self, now: float, dt: float) -> None:
        """Do nothing: `advance` has set the commands."""

    def request(self, request: BaseRequest, now: float) -> None:
        """Carry out a request of the caller.

        Raises:
            LifeCycleError: the present mode forbids the request.
        """
        status = self.status
        if request is BaseRequest.LAND:
            self._land(now)
            if status.mode is Mode.FAULT:
                raise LifeCycleError(f"{self.name}: torque is not cut: {status.message}")
        elif request is BaseRequest.RESET_ODOMETRY:
            if status.mode is Mode.TRACK and self._target.pose:
                raise LifeCycleError(f"{self.name}: drives to a pose of the odometry; let it hold first")
            self.motion.reset_odometry()
            self._target = self._target if self._target.frame is Frame.LOCAL else REST  # it was of the frame before
        elif request is BaseRequest.REARM:
            self._rearm.begin()
        elif status.mode is Mode.FAULT:
            raise LifeCycleError(f"{self.name}: {status.message}; re-arm it first")
        elif request is BaseRequest.HOLD and status.mode not in (Mode.STOPPED, Mode.BRING_UP):
            self._rest(Mode.HOLD)
        elif request is BaseRequest.HOME_RAIL:
            if self.rail is None or status.mode not in (Mode.HOLD, Mode.TRACK) or status.halted:
                raise LifeCycleError(f"{self.name}: cannot home a rail in mode {status.mode.name.lower()}")
            self._rest(Mode.HOLD)
            self.rail.start_homing()

    def _rest(self, mode: Mode) -> None:
        """Enter a mode, or stay in it, in which base and rail brake to rest."""
        if self.status.mode is not mode:
            self.status.enter(mode)
        self._target = REST
        if self.rail is not None:
            self.rail.stop()

    def _at_rest(self) -> bool:
        rail = self.rail is None or self.rail.at_rest
        rests = (np.abs(self.motion.velocity) < _REST) & (np.abs(self.motion.odometry.twist) < _REST)
        return rail and bool(rests.all())

    def _land(self, now: float, trouble: Trouble | None = None, message: str = "") -> None:
        """Brake, then cut torque. An emergency stop delays this; a base that is off already is left alone."""
        status = self.status
        if status.mode in (Mode.LAND, Mode.OFF) or status.letting_go:
            return
        if status.mode is Mode.FAULT and self.rail is not None and self.rail.must_hold:
            return  # the carriage would fall
        if status.mode is Mode.OFFLINE and trouble is None:
            status.enter(Mode.OFF)
            return
        status.trouble, status.message = trouble, message
        if status.mode is Mode.STOPPED:
            status.must_land = True
            return
        self._until_s, self._rests_s = now + _BRAKE_S, math.inf
        self._rest(Mode.LAND)

    def end(self, now: float) -> None:
        """Land because the loop has to end."""
        if not self.status.rearming:
            self._land(now, self.status.trouble, self.status.message)

    def _switch_off(self) -> None:
        self._heed(self._exit.begin())

    def _heed(self, finding: Finding | None) -> None:
        """Hold after all, if switching off has found a reason."""
        if finding is not None:
            self._fault(*finding)

    def _suffer(self, trouble: Trouble, message: str) -> None:
        """Brake and hold with every motor that still obeys, and inform the other parts of the robot."""
        status = self.status
        if status.mode in (Mode.FAULT, Mode.LAND) or status.letting_go or status.ended:
            return
        self._fault(trouble, message)

    def _fault(self, trouble: Trouble, message: str) -> None:
        status = self.status
        logger.error("%s (%s): %s: %s", self.name, self.config.channel, trouble, message)
        self._news = status.trouble = trouble
        status.message, status.must_land = message, False
        self._rest(Mode.FAULT)

    def fail(self, error: Exception) -> None:
        """Command velocity 0 after an error in our own code."""
        logger.critical("%s: internal error, stopping", self.name, exc_info=error)
        self.motors.asked[:] = 0.0
        self._suffer(Trouble.INTERNAL_ERROR, f"internal error, stopping: {error!r}")

    def take_news(self) -> Trouble | None:
        news, self._news = self._news, None
        return news

    def halt(self, peer: ArmStatus) -> None:
        """Brake, and refuse targets until re-armed: another part of the robot has a fault."""
        status = self.status
        if status.mode in (Mode.HOLD, Mode.TRACK, Mode.STOPPED):
            logger.warning("%s: stops: %s is in trouble: %s", self.name, peer.name, peer.trouble)
            status.halted = True
            status.limited |= Limited.PEER
            if status.mode is not Mode.STOPPED:
                self._rest(Mode.HOLD)

    def _restart(self) -> None:
        """Plan anew from where the base is."""
        self._stalls.forget()
        self.motion.restart()
        if self.rail is not None:
            self.rail.rearm()
