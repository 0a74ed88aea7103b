"""The controller of a mobile base: requests, targets, faults and the emergency stop move it from mode to mode.

HOLD commands velocity 0, so that the base stays on a slope. TRACK follows targets; a target that is too old is followed
by planned braking to rest. STOPPED and FAULT brake with the hard cap of acceleration. LAND brakes as usual, and then
cuts torque.
"""

import logging
import math
from collections.abc import Callable, Generator, Iterator

import can
import numpy as np

from lerobot_robot_yam.control.arm_status import ArmStatus
from lerobot_robot_yam.control.joints.enabling import enable
from lerobot_robot_yam.control.mobile.steering_monitor import SteeringMonitor
from lerobot_robot_yam.control.preflight.arm_inspection import refuse_stopped
from lerobot_robot_yam.control.safety.channel_monitor import BusLoss, ChannelMonitor
from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.motor_inspection import LISTEN_S, check_bandwidth, listen, verify
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.errors import BusError, ChannelInUseError, LifeCycleError, MotorError, YamError
from lerobot_robot_yam.mobile.base_motion import REST, BaseMotion, Target
from lerobot_robot_yam.mobile.resolved_base import ResolvedBase
from lerobot_robot_yam.state.base_records import BaseRequest
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.faults import RESPONSES, Trouble
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Limited
from lerobot_robot_yam.system.clock import Clock

logger = logging.getLogger(__name__)

_DQ = 1  # column of the velocity in the commands of a chain
_READY_TICKS = 20  # ticks within which every motor must report that it is enabled: a reply may get lost
_REST = np.array([0.005, 0.005, 0.01])  # velocities below which the base counts as at rest, m/s, m/s, rad/s
_OFF_S = 0.05  # wait for motors to report that they are off, s; the adapter's delay is added
_BRAKE_S = 4.0  # maximum time of braking before torque is cut, s: from the highest speed, twice over
_MOST_DT_S = 0.05  # maximum measured period that is integrated at once, s; a longer gap is split


class BaseController:
    """Controller of one base's motors.

    Args:
        hardware: the base.
        bus: an open bus; the controller does not close it.

    Attributes:
        motion: plan and odometry.
        q, dq, tau: (n,) measured state in joint coordinates, rad, rad/s, Nm.
        instead: index of a motor -> special command that is sent once in place of its command.
    """

    def __init__(self, hardware: ResolvedBase, bus: can.BusABC):
        self.hardware, self.config, self.name = hardware, hardware.config, hardware.name
        self.status = ArmStatus(self.name, floats=False)
        self.chain, self._bus = MotorChain(bus, hardware.motors, channel=self.config.channel), bus
        self.motion = BaseMotion(hardware.profile, hardware.limits)
        self._watch, self._bus_loss, self._steering = ChannelMonitor(self.chain), BusLoss(), SteeringMonitor(hardware)
        self.q, self.dq, self.tau = np.zeros(hardware.n), np.zeros(hardware.n), np.zeros(hardware.n)
        self.instead: dict[int, SpecialCommand] = {}
        self._commands = np.zeros((hardware.n, 5))
        self._target, self._target_s = REST, -math.inf
        self._measured_s = math.nan  # time of the samples that the odometry took last
        self._until_s = math.inf  # when braking or switching off ends at the latest
        self._rearming: Generator[None, None, None] | None = None
        self._news: Trouble | None = None

    @property
    def mode(self) -> Mode:
        return self.status.mode

    @property
    def clock(self) -> Clock:
        return self.chain.clock

    @property
    def wire_s(self) -> float:
        return self.chain.expected_wire_s

    @property
    def lost(self) -> int:
        return int(self.chain.lost.sum())

    @property
    def steer(self) -> np.ndarray:
        """Measured steering angles (4,), rad."""
        return self.q[0:8:2]

    def inspect(self) -> None:
        """Check that everything is there and as configured. Sends no command that moves or energises anything.

        Raises:
            YamError: a part is missing or differs; the message names it.
        """
        config, chain = self.config, self.chain
        refuse_stopped(self.name, EmergencyStop())
        check_bandwidth(len(chain), False, config.rate_hz)
        if not config.skip_listen:
            listen(self._bus, LISTEN_S, [motor.can_id for motor in chain.motors], config.channel)
        verify(chain)
        self._read()

    def energise(self) -> Iterator[None]:
        """Enable the motors, one step per tick, at velocity 0.

        Raises:
            ChannelInUseError: another driver commands these motors; nothing was sent.
            MotorError: a motor does not enable.
        """
        where = f"{self.name} ({self.config.channel})"
        self.chain.drain()
        if self.chain.foreign_commands:
            raise ChannelInUseError(f"{where}: another driver commands the motors; stop it and try again")
        self.status.enter(Mode.BRING_UP)
        silent = yield from enable(self, range(self.hardware.n), clear=True)
        if silent:
            raise MotorError(f"{where}: cannot enable {self._names(silent)}: no answer; check power and cable")
        for _ in range(_READY_TICKS):
            yield
            finding = self._watch.check(self.clock.now())
            if not finding.bad.any():
                break
        if finding.bad.any() or finding.trouble is not None:
            raise MotorError(f"{where}: cannot enable {finding.message}; power-cycle the base or look at its motors")

    def start_send(self) -> None:
        self._send()

    def start_receive(self, until_s: float) -> None:
        self.chain.collect(until_s)
        self._read()

    def abandon(self) -> None:
        if not self.status.ended:
            self._switch_off(self.clock.now())

    def adopt(self, record: np.ndarray, now: float) -> None:
        """Take over from a loop that has died: brake, then cut torque. `record`: the last state that it published."""
        assumed = np.nan_to_num(record["q"][: self.hardware.n]) * self.hardware.sign
        self.chain.feedback.assume(assumed, np.zeros(self.hardware.n), record["motor_stamp_s"][: self.hardware.n])
        for _ in range(3):
            if all(self.chain.refresh(timeout_s=0.01)):
                break
        self._read()
        if not (self.chain.fault == Fault.NORMAL).any():
            self.status.enter(Mode.OFF)
            return
        self.motion.odometry.pose = record["pose"].copy()
        self.motion.velocity = record["planned"].copy()
        self._land(now, Trouble.CONTROL_DEAD, "its control process has died; the stand-by brakes it")
        self.advance(now, 0.004)
        self.compute_command(now, 0.0)

    def send(self) -> None:
        self._talk(self._send)

    def _send(self) -> None:
        instead, self.instead = self.instead, {}
        self.chain.send(self._commands, instead)
        self._bus_loss.clear()

    def drain(self) -> None:
        self._talk(self.chain.drain)

    def collect(self, until_s: float) -> None:
        self._talk(lambda: self.chain.collect(until_s))

    def _talk(self, work: Callable[[], object]) -> None:
        """Run `work`, which sends or receives frames; respond to a lost channel."""
        try:
            work()
        except BusError as error:
            trouble = self._bus_loss.note(error, self.clock.now())
            if trouble is not None:
                self._suffer(trouble, str(error))
        except Exception as error:  # other parts of the robot must be commanded all the same
            self.fail(error)

    def _read(self) -> None:
        sign, chain = self.hardware.sign, self.chain
        self.q, self.dq, self.tau = chain.position_rad * sign, chain.velocity_rad_s * sign, chain.torque_nm * sign

    def measure(self, now: float) -> None:
        """Update state and odometry from the replies; respond to faults as the table in `state.faults` says."""
        self._read()
        if self.status.letting_go:
            self._let_go(now)
            return
        self._measure_way()
        finding = self._watch.check(now)
        if finding.trouble is not None:
            self._suffer(finding.trouble, finding.message)
            return
        stalled = self._steering.check(now, self._commands[0:8:2, _DQ] * self.hardware.sign[0:8:2], self.dq[0:8:2])
        if stalled:
            self._suffer(Trouble.STEERING_STALLED, f"{self.name}: {stalled}")

    def _measure_way(self) -> None:
        """Integrate the odometry over the time between the samples, not over the nominal period."""
        stamp_s = float(np.median(self.chain.stamp_s[:8]))
        dt, self._measured_s = stamp_s - self._measured_s, stamp_s
        if dt > 0.0:  # False for NaN
            self.motion.measure(self.steer, self.dq[:8], min(dt, _MOST_DT_S))

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
        self._advance_rearm()
        if status.mode is Mode.BRING_UP:
            status.enter(Mode.HOLD)
        elif status.mode is Mode.TRACK and now - self._target_s > self.config.command_timeout_s:
            status.limited |= Limited.COMMAND_TIMEOUT
            logger.info("%s: no target for %g s; it brakes", self.name, self.config.command_timeout_s)
            self._rest(Mode.HOLD)
        elif status.mode is Mode.LAND and (self._at_rest() or now > self._until_s):
            self._switch_off(now)

    def set_target(self, target: Target, now: float, age_s: float) -> bool:
        """Accept a target given `age_s` ago, if the base holds or tracks; return whether it does."""
        status = self.status
        if status.mode not in (Mode.HOLD, Mode.TRACK) or status.halted or age_s > self.config.command_timeout_s:
            return False
        self._target, self._target_s = target, now - age_s
        status.limited = Limited.NOTHING
        if status.mode is Mode.HOLD:
            status.enter(Mode.TRACK)
        return True

    def advance(self, now: float, dt: float) -> None:
        """Plan one tick, and set the rates of the casters."""
        hard = self.status.mode in (Mode.STOPPED, Mode.FAULT)
        rates = self.motion.advance(self._target, self.steer, dt, hard=hard) if dt > 0.0 else self.dq[:8]
        if self.motion.slowed < 1.0:
            self.status.limited |= Limited.SPEED
        self._commands[:8, _DQ] = rates * self.hardware.sign[:8]

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
        elif request is BaseRequest.RESET_ODOMETRY:
            if status.mode is Mode.TRACK and self._target.pose:
                raise LifeCycleError(f"{self.name}: drives to a pose of the odometry; let it hold first")
            self.motion.reset_odometry()
        elif request is BaseRequest.REARM:
            self._begin_rearm()
        elif status.mode is Mode.FAULT:
            raise LifeCycleError(f"{self.name}: {status.message}; re-arm it first")
        elif request is BaseRequest.HOLD and status.mode not in (Mode.HOLD, Mode.STOPPED, Mode.BRING_UP):
            self._rest(Mode.HOLD)

    def _rest(self, mode: Mode) -> None:
        """Enter a mode in which the plan brakes to rest."""
        self.status.enter(mode)
        self._target = REST

    def _at_rest(self) -> bool:
        return bool((np.abs(self.motion.velocity) < _REST).all() and (np.abs(self.motion.odometry.twist) < _REST).all())

    def _land(self, now: float, trouble: Trouble | None = None, message: str = "") -> None:
        """Brake, then cut torque. An emergency stop delays this; a base that is off already is left alone."""
        status = self.status
        if status.mode in (Mode.LAND, Mode.OFF):
            return
        if status.mode is Mode.OFFLINE and trouble is None:
            status.enter(Mode.OFF)
            return
        status.trouble, status.message = trouble, message
        if status.mode is Mode.STOPPED:
            status.must_land = True
            return
        self._until_s = now + _BRAKE_S
        self._rest(Mode.LAND)

    def end(self, now: float) -> None:
        """Land because the loop has to end."""
        if not self.status.rearming:
            self._land(now, self.status.trouble, self.status.message)

    def _switch_off(self, now: float) -> None:
        self.status.check(Mode.OFF)
        self.status.letting_go = True
        self._until_s = now + _OFF_S + 2.0 * self.chain.round_trip.one_way_s
        self.instead = dict.fromkeys(range(self.hardware.n), SpecialCommand.DISABLE)

    def _let_go(self, now: float) -> None:
        """Advance switching off by one tick."""
        on = np.flatnonzero(self.chain.fault == Fault.NORMAL).tolist()
        if on and now < self._until_s:
            self.instead = dict.fromkeys(on, SpecialCommand.DISABLE)
            return
        if on:
            logger.error("%s: %s did not report off; their watchdogs switch them off", self.name, self._names(on))
        self.status.enter(Mode.OFF)
        self.status.letting_go = False

    def _suffer(self, trouble: Trouble, message: str) -> None:
        """Brake and hold with every motor that still obeys, and inform the other parts of the robot."""
        status = self.status
        if status.mode in (Mode.FAULT, Mode.LAND) or status.letting_go or status.ended:
            return
        logger.error("%s (%s): %s: %s", self.name, self.config.channel, trouble, message)
        self._news = status.trouble = trouble
        status.message, status.must_land = message, False
        self._rest(Mode.FAULT)

    def fail(self, error: Exception) -> None:
        """Command velocity 0 after an error in our own code."""
        logger.critical("%s: internal error, stopping", self.name, exc_info=error)
        self._commands[:] = 0.0
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
            if status.mode is Mode.TRACK:
                self._rest(Mode.HOLD)

    def _begin_rearm(self) -> None:
        status = self.status
        if status.mode is Mode.LAND or status.must_land:
            raise LifeCycleError(f"{self.name}: {status.message or 'it has been told to stop'}; connect again")
        if status.mode is not Mode.FAULT:
            status.halted = False
            return
        assert status.trouble is not None
        if not RESPONSES[status.trouble].in_place:
            raise LifeCycleError(f"{self.name}: {status.message}; {RESPONSES[status.trouble].rearm}")
        self._rearming, status.rearming = self._rearm(), True

    def _rearm(self) -> Generator[None, None, None]:
        failed = np.flatnonzero(self._watch.check(self.clock.now()).bad).tolist()
        silent = yield from enable(self, failed, clear=True)
        for _ in range(_READY_TICKS):
            yield
            finding = self._watch.check(self.clock.now())
            if not finding.bad.any():
                break
        if silent or finding.bad.any():
            raise MotorError(f"{self.name}: {finding.message or self._names(silent)}; look at the motor, then re-arm")
        self._steering.forget()
        self.motion.restart()
        status = self.status
        status.enter(Mode.HOLD)
        status.trouble, status.message, status.halted, status.limited = None, "", False, Limited.NOTHING
        logger.info("%s: re-armed", self.name)

    def _advance_rearm(self) -> None:
        work, self._rearming = self._rearming, None
        if work is None:
            return
        self.status.rearming = False
        try:
            next(work)
        except StopIteration:
            return
        except YamError as error:
            self.status.refusal = str(error)
            return
        self._rearming, self.status.rearming = work, True

    def _names(self, motors: list[int]) -> str:
        return ", ".join(f"{self.chain.motors[i].name} (id {self.chain.motors[i].can_id})" for i in motors)

    def complaints(self) -> list[str]:
        if not self.chain.round_trip.slow:
            return []
        return [f"{self.name} ({self.chain.channel}): {self.chain.round_trip.summary()}"]
