"""The rail of a base: plan, brake and homing of its motor, which ticks as the ninth of the base's channel.

A velocity servo creeps under load. So the planned angle is held by an outer loop, rate = plan' + K (plan − q), except
where the brake holds: against a brake a servo would wind up. When the motor does not answer, the output of the brake
engages it at once; the plan stops two ticks later, since a brake takes longer to grip, and replies may get lost.
"""

import logging
import math
import threading
from collections.abc import Generator

import numpy as np

from lerobot_robot_yam.control.loop_timing import MOST_DT_S
from lerobot_robot_yam.control.mobile.base_motors import RAIL, BaseMotors
from lerobot_robot_yam.control.mobile.rail_boards import open_board, open_checked
from lerobot_robot_yam.control.mobile.rail_brake import RailBrake
from lerobot_robot_yam.control.mobile.rail_calibration import RailCalibration, check_travel, load, store
from lerobot_robot_yam.control.mobile.rail_homing import seek
from lerobot_robot_yam.control.mobile.rail_monitor import Finding, RailMonitor
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.errors import MotorError
from lerobot_robot_yam.mobile.rail_motion import RailMotion
from lerobot_robot_yam.mobile.rail_profile import (
    HOMING_RAD_S,
    SOFT_END_M,
    SPEED_RAD_S,
    STOP_RAD_S2,
    RailScale,
    RailTarget,
)
from lerobot_robot_yam.mobile.resolved_base import ResolvedBase
from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.system.boards.awaited_board import AwaitedBoard
from lerobot_robot_yam.system.boards.switch_board import LostBoard, SwitchBoard

logger = logging.getLogger(__name__)

_K = 10.0  # gain of the outer loop, 1/s: a tenth of what the loop's delay of 8 ms would make unstable
_CORRECTION_RAD_S = 5.0  # maximum rate that the outer loop adds, rad/s
_MISSED = 2  # commands in a row without a reply after which the brake is engaged, long before that is a fault
_SURE = 3  # ticks of this after which the plan stops, too: two lost replies may leave the motor out of a third tick
_FORGOTTEN = 0.1  # ticks of this that a tick without makes up for: a motor heard now and then is no sound one
_REST_RAD_S = 0.2  # rate below which the carriage counts as at rest, rad/s
_SLIP_M, _USUAL_M_PER_RAD = 0.001, 0.03  # motion without torque that means that the brake slips, m; scale before homing
_FRESH_S = 0.05  # age of a reading that is surely from after the brake has gripped, s
_WATCH_S = 0.4  # time that the carriage is watched after torque was cut, s
_KNOWN_RAD = 0.5  # motion in a fault beyond which the height is unknown, rad: a motor without power forgets turns
_REGAIN_S = 0.5  # time for enabling the motor again once the brake slips, s; a motor that fails is off by then
_HOMING_RAD_S2 = 20.0  # acceleration while it homes, rad/s²
_FAR_RAD = 1e4  # beyond the end of any rail, rad
_MOVES = (Mode.HOLD, Mode.TRACK)


class RailController:
    """Controller of one base's rail. scale: None until it is homed. target_s: time of the newest target."""

    def __init__(self, hardware: ResolvedBase, motors: BaseMotors):
        assert hardware.config.rail is not None
        self.name, self._config, self._hardware = hardware.name, hardware.config.rail, hardware
        self._motors, self._chain, self._clock = motors, motors.chain, motors.chain.clock
        self._motion, self._brake = RailMotion(), RailBrake()
        self._monitor = RailMonitor(self.name, self._config.stroke_m)
        self._io: SwitchBoard = LostBoard()
        self._raw = self.sample = self._io.read()
        self.scale: RailScale | None = None
        self._calibration: RailCalibration | None = None
        self._target, self.target_s = RailTarget(0.0), -math.inf
        self._homing: Generator[float, None, None] | None = None
        self._place: float | None = None  # angle at which the brake has taken the carriage; of a silent motor the last
        self._held: float | None = None  # the same, as surely read after that
        self._failure: Finding | None = None
        self._writer: threading.Thread | None = None
        self._suspect = self._leaving = self._slipped = False
        self._doubts, self._planned_s = 0.0, math.inf

    @property
    def q(self) -> float:
        """Angle of the motor, rad."""
        return float(self._motors.q[RAIL])

    @property
    def height_m(self) -> float:
        """Height above the lower switch, m; NaN before homing."""
        return math.nan if self.scale is None else self.scale.height(self.q)

    @property
    def homing(self) -> bool:
        return self._homing is not None

    @property
    def at_rest(self) -> bool:
        return self._motion.velocity == 0.0 and abs(float(self._motors.dq[RAIL])) < _REST_RAD_S

    @property
    def must_hold(self) -> bool:
        """Whether torque must not be cut, because the brake does not hold or cannot be engaged."""
        return self._enabled and (self._slipped or self._monitor.silent)

    @property
    def _enabled(self) -> bool:
        return bool(self._chain.fault[RAIL] == Fault.NORMAL)

    def _slips(self) -> bool:
        """Return whether the carriage has moved since its brake has taken it."""
        metres_per_rad = self.scale.metres_per_rad if self.scale else _USUAL_M_PER_RAD
        return self._held is not None and abs(self.q - self._held) * metres_per_rad > _SLIP_M

    def is_up(self, now: float) -> bool:
        """Return whether the motor holds and the brake has let go."""
        return self._brake.free(now)

    def inspect(self) -> None:
        """Open the board and check the switches; nothing moves. Raises YamError: no answer, or both are triggered."""
        self._io, self._raw = open_checked(self._hardware, self._clock)
        self.sample = self._raw
        self._calibration = load(self.name, self._config.calibration_path, self._config.stroke_m)
        self.scale = None if self._calibration is None else self._calibration.scale(self.q)

    def adopt(self, record: np.ndarray) -> None:
        """Take over from a loop that has died: engage the brake, once its process is gone, and stop.

        record: its last state.
        """
        self._io = AwaitedBoard(f"{self.name}: rail", lambda: open_board(self._hardware))
        if record["rail_homed"]:
            self.scale = RailScale(float(record["rail_m_per_rad"]), float(record["rail_zero_rad"]))
            travel_rad = self._config.stroke_m / self.scale.metres_per_rad
            self._calibration = RailCalibration(self._config.stroke_m, travel_rad)
        self._slipped = record["trouble"] == Trouble.RAIL_BRAKE.encode()
        self._motion.restart(self.q, float(self._motors.dq[RAIL]))

    def close(self) -> None:
        """Close the driver. Idempotent."""
        io, self._io = self._io, LostBoard()
        io.close()
        if self._writer is not None:
            self._writer.join()

    def describe(self, record: np.ndarray) -> None:
        """Write the rail's part of a base's state."""
        scale = self.scale or RailScale(math.nan, math.nan)
        record["rail_homed"], record["rail_homing"] = self.scale is not None, self.homing
        record["rail_m_per_rad"], record["rail_zero_rad"] = scale
        record["rail_upper"], record["rail_lower"] = self.sample.upper, self.sample.lower
        record["rail_brake_on"] = self.sample.brake_on is not False

    def measure(self, now: float) -> Finding | None:
        """Read the driver; engage the brake at once if the motor does not answer. Return what is wrong."""
        self._read()
        late_s = now - self._planned_s - MOST_DT_S
        if late_s > 0.0:  # after a pause of the loop: the motor went on, and so does its plan
            self._motion.position += self._motion.velocity * late_s
        doubt = not self._enabled or bool(self._chain.missed[RAIL] >= _MISSED)
        self._doubts = min(self._doubts + 1.0, _SURE) if doubt else max(self._doubts - _FORGOTTEN, 0.0)
        self._suspect = self._doubts >= _SURE
        self._brake.look(self.sample, now, doubt)
        if doubt:
            self._brake.set(self._io, self._suspect or self._brake.engaged, now)
        failure, self._failure = self._failure, None
        if self._slips() and not self._slipped:
            self._slipped = True
            self._motion.restart(self.q)
            failure = (
                Trouble.RAIL_BRAKE,
                f"{self.name}: rail: its brake does not hold, but its motor; support the load",
            )
        lag_rad = self._motion.position - self.q if self._brake.free(now) else 0.0
        finding = failure or self._monitor.check(now, self.sample, self._brake, self.height_m, lag_rad)
        if finding is not None and finding[0] is Trouble.RAIL_SWITCH:
            self.scale = None  # the height may be wrong, too
        return finding

    def _read(self) -> None:
        """Read the driver. A switch has changed once two samples agree: contacts bounce, and wires pick up noise."""
        before, self._raw = self._raw, self._io.read()
        if self._raw.stamp_s == before.stamp_s:
            return
        upper, lower = (
            new if new == old else said
            for new, old, said in zip(self._raw[:2], before[:2], self.sample[:2], strict=True)
        )
        self.sample = self._raw._replace(upper=upper, lower=lower)

    def set_target(self, target: RailTarget, given_s: float) -> None:
        """Accept a target, given at `given_s`, unless the rail homes or has not been homed."""
        if self._homing is None and self.scale is not None:
            self._target, self.target_s = target, given_s

    def stop(self) -> None:
        """Give up target and homing: brake and stay."""
        self.target_s, self._homing = -math.inf, None

    def start_homing(self) -> None:
        """Begin to home, as soon as the brake is free: after a fault it takes a moment."""
        self.stop()
        self._homing = self._home()

    def _home(self) -> Generator[float, None, None]:
        self.scale = None
        upper_rad = yield from seek(self, self._clock.now, 1.0)
        lower_rad = yield from seek(self, self._clock.now, -1.0)
        found = RailCalibration(self._config.stroke_m, upper_rad - lower_rad)
        check_travel(self.name, found, self._calibration)
        self._calibration, self.scale = found, RailScale(found.metres_per_rad, lower_rad)
        while self.height_m < SOFT_END_M:
            yield 0.25 * HOMING_RAD_S
        self._store(None)
        logger.info("%s: rail homed: %.5f m/rad", self.name, self.scale.metres_per_rad)

    def advance(self, now: float, dt: float, mode: Mode) -> float:
        """Plan `dt` seconds in this mode of the base, set brake and motor; return the share of speed for the base."""
        self._planned_s = now
        self._brake.set(self._io, self._wants_brake(mode), now)
        if self._brake.holds(now) and not self._slipped:
            self._place = self.q if self._place is None else self._place
            if self._held is None and now - self._chain.stamp_s[RAIL] < _FRESH_S:  # else it is from before
                self._held = self.q
            self._motion.restart(self.q)
        elif self._brake.free(now) and mode in _MOVES:
            self._move(now, dt)
        else:
            self._motion.brake(STOP_RAD_S2, dt)
        if not self._brake.engaged:
            self._place = self._held = None
        correction = _K * (self._motion.position - self.q)
        limit = _CORRECTION_RAD_S
        self._motors.asked[RAIL] = self._motion.velocity + min(max(correction, -limit), limit)
        return self._config.driving_share(self.height_m)

    def _wants_brake(self, mode: Mode) -> bool:
        if self._suspect or self._leaving or self._slipped:
            return True
        if mode in (Mode.BRING_UP, Mode.HOLD, Mode.TRACK):
            if self._brake.engaged:
                self._motion.restart(self.q)  # the motor holds where the carriage is
                self._store(None)  # it may move from now on
            return False
        stops = mode in (Mode.STOPPED, Mode.LAND)  # the motor stops first; a fault has no time for that
        return self._brake.engaged or not stops or self.at_rest

    def _move(self, now: float, dt: float) -> None:
        motion, scale = self._motion, self.scale
        if self._homing is not None:
            motion.run(self._advance_homing(), (-_FAR_RAD, _FAR_RAD), _HOMING_RAD_S2, dt)
        elif scale is None or now - self.target_s > self._hardware.config.command_timeout_s:
            motion.brake(self._config.acceleration_limit / scale.metres_per_rad if scale else _HOMING_RAD_S2, dt)
        else:
            ends = scale.angle(SOFT_END_M), scale.angle(self._config.stroke_m - SOFT_END_M)
            acceleration = self._config.acceleration_limit / scale.metres_per_rad
            speed = min(self._config.velocity_limit / scale.metres_per_rad, SPEED_RAD_S)
            if self._target.height:
                motion.reach(min(max(scale.angle(self._target.value), ends[0]), ends[1]), speed, acceleration, dt)
            else:
                asked = self._target.value / scale.metres_per_rad
                motion.run(min(max(asked, -speed), speed), ends, acceleration, dt)
        if (self.sample.upper and motion.velocity > 0.0) or (self.sample.lower and motion.velocity < 0.0):
            motion.restart(self.q)  # as the vendor's driver: a switch stops the motor at once

    def _advance_homing(self) -> float:
        assert self._homing is not None
        try:
            return next(self._homing)
        except StopIteration:
            pass
        except MotorError as error:
            self._failure = Trouble.RAIL_HOMING, str(error)
        self._homing = None
        return 0.0

    def let_go(self) -> Generator[None, None, Finding | None]:
        """Engage the brake, cut the motor's torque, and watch, one step per tick. Return why it holds instead."""
        self._leaving = not self._slipped
        self.stop()
        while not (self._brake.holds(now := self._clock.now()) or self._brake.unconfirmed(now)):
            self._brake.set(self._io, True, now)
            yield
        until_s = now + _WATCH_S
        while self._leaving and self._brake.holds(now) and not self._slipped:
            if now > until_s:
                self._store(self.q)
                return None
            if self._enabled:
                self._motors.instead = {RAIL: SpecialCommand.DISABLE}
            yield
            now = self._clock.now()
        self._leaving = False
        until_s = self._clock.now() + _REGAIN_S
        while self._slipped and not self._enabled and self._clock.now() < until_s:
            off = self._chain.fault[RAIL] == Fault.DISABLED
            self._motors.instead = {RAIL: SpecialCommand.ENABLE if off else SpecialCommand.CLEAR}
            yield
        why = "its brake does not hold" if self._slipped else "its brake is not confirmed to be engaged"
        what = f"{self.name}: rail: {why}, so the motor holds the carriage, and torque is not cut; support the load"
        heard = math.isfinite(self._chain.stamp_s[RAIL])
        return (Trouble.RAIL_BRAKE, what) if self._enabled or not heard else None

    def rearm(self) -> None:
        """Hold with the motor and release the brake again, after a fault; a motor that lost its turns has to home."""
        if self._place is not None and abs(self.q - self._place) > _KNOWN_RAD:
            self.scale = None
        self._slipped, self._leaving, self._place, self._held = False, False, None, None
        self._motion.restart(self.q)

    def _store(self, q: float | None) -> None:
        """Write the file in a thread, since a disk may take longer than a tick."""
        path, found = self._config.calibration_path, self._calibration
        if path is not None and found is not None:
            place = q if self.scale else None
            row = self.name, path, found, place, 0.0 if place is None else self.height_m
            self._writer = threading.Thread(target=store, args=row, name="yam-rail-store")
            self._writer.start()
