"""The caller's handle on one arm: its state block to read, its command block to write."""

import contextlib
import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.arm.validation import check_range, finite_number, finite_vector
from lerobot_robot_yam.control.gripper.stored_stops import await_stored
from lerobot_robot_yam.damiao.tables import motor_type
from lerobot_robot_yam.errors import GripperError, LifeCycleError, MotorError, StaleStateError, YamError
from lerobot_robot_yam.session.command_writer import CommandWriter
from lerobot_robot_yam.session.target_limits import LimitLog, limit_target
from lerobot_robot_yam.state.block_pair import Descriptors
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import (
    PUBLISHED_AT,
    STATE_DTYPE,
    ArmState,
    Limited,
    Request,
    lock_path,
    state_path,
)
from lerobot_robot_yam.system.clock import SYSTEM, Clock
from lerobot_robot_yam.system.runtime_files import FileLock
from lerobot_robot_yam.system.shared_block import SharedBlock, allocate

logger = logging.getLogger(__name__)

_REQUEST_TIMEOUT_S = 1.0
_LET_GO_S = 1.0
_SEARCH_TIMEOUT_S = 20.0
_FAILED = (Mode.FAULT, Mode.LAND, Mode.OFF)  # with a message: not because the caller has asked for it
_CALIBRATE = "calibrate it (lerobot-calibrate)"
_WITHOUT_STOPS = {
    Mode.BRING_UP: "they are being sought; wait",
    Mode.STOPPED: "they are sought when the emergency stop is released (yam-estop release)",
}
_NEARLY_S = 0.0013  # a state that comes so soon is worth waiting for: the one before it is a whole tick older
_LATE_S = 0.003  # how long it is waited for beyond; the loop itself waits up to 2 ms for a reply
_OLD_S = 0.0025  # a sample that is older than a tick and this is not the newest that could be had
_GLANCE_S = 0.00005


class ArmPort:
    """One arm of a running session. One thread writes; reading is free."""

    def __init__(self, config: ArmConfig, hardware: ResolvedArm, key: str, clock: Clock = SYSTEM):
        self.config = config
        self.hardware = hardware
        self._key = key
        self._clock = clock
        self._commands = CommandWriter(config.name, hardware.n)
        self._states: SharedBlock | None = SharedBlock(None, STATE_DTYPE, False, allocate(STATE_DTYPE))
        self._period_s = 1.0 / config.rate_hz if config.rate_hz > 0 and clock is SYSTEM else 0.0
        self._lower, self._upper = hardware.lower.tolist(), hardware.upper.tolist()
        types = [motor_type(motor.type) for motor in hardware.motors[: hardware.joints]]
        self._ranges = {
            "dq": (-1.0, np.array([row.velocity_max_rad_s for row in types])),
            "kp": (0.0, np.array([row.kp_max for row in types])),
            "kd": (0.0, np.array([row.kd_max for row in types])),
        }
        self._newest: tuple[int, ArmState] | None = None  # that was found to be well, and its number in the block
        self._limit_log = LimitLog(config.name)

    @property
    def descriptors(self) -> Descriptors:
        """Of the memory of both blocks, for the loop.

        Raises:
            LifeCycleError: closed.
        """
        if self._states is None:
            raise LifeCycleError(f"{self.config.name}: not connected")
        return Descriptors(self._states.descriptor, self._commands.descriptor)

    def close(self) -> None:
        """Let go of the blocks; the arm is not touched."""
        self._commands.close()
        if self._states is not None:
            self._states.close()
            self._states = None

    def published(self) -> ArmState:
        """The state as last published, however old, whatever is wrong with the arm.

        Raises:
            LifeCycleError: not connected.
        """
        payload = None if self._states is None else self._states.read_bytes()
        if payload is None:
            raise LifeCycleError(f"{self.config.name}: not connected")
        return ArmState(payload)

    def mode(self) -> Mode:
        """Life-cycle state as last published, however old."""
        return self.published().mode

    def observe(self) -> ArmState:
        """The newest state of the arm, see `await_fresh`.

        Raises:
            MotorError: a motor has a fault; names it.
            StaleStateError: the control loop or a motor has been silent for longer than `max_state_age_s`.
            GripperError: its stops are unknown, so that its position is.
            LifeCycleError: not connected.
        """
        self.await_fresh()
        return self.newest()

    def await_fresh(self) -> None:
        """Wait for a tick that ends within 1.3 ms; then, where a reply to the last one was lost, for the next.

        At most two ticks and a few milliseconds. A motor that has missed more is not waited for. Who observes several
        arms waits for all of them first: while it waited for one, what it had read of another would age.

        Raises:
            YamError: as `observe`.
        """
        states, period_s = self._states, self._period_s
        if not period_s or states is None:
            return
        self._await_tick(states, states.sequence(), _NEARLY_S)
        age_s = self._clock.now() - self.newest().stamp_s
        if self._newest is not None and period_s + _OLD_S < age_s < 2.0 * period_s + _OLD_S:
            self._await_tick(states, self._newest[0], period_s)

    def _await_tick(self, states: SharedBlock, sequence: int, within_s: float) -> None:
        """Let the tick after record `sequence` end if it should so soon; one that is late is not waited for."""
        due = states.peek_float(PUBLISHED_AT) + self._period_s
        if due - within_s < self._clock.now():
            while states.sequence() == sequence and self._clock.now() < due + _LATE_S:
                self._clock.sleep(_GLANCE_S)

    def newest(self) -> ArmState:
        """As `observe`, without waiting."""
        states, newest = self._states, self._newest
        if states is None:
            raise LifeCycleError(f"{self.config.name}: not connected")
        sequence = states.sequence()  # before the record: that may be newer than its number, never older
        if newest is None or newest[0] != sequence:  # who observes answers within one tick: it is not read twice
            newest = self._newest = (sequence, self._examined())
        state = newest[1]
        self._check_age(state.asked_s)
        return state

    def _check_age(self, asked_s: float) -> None:
        age = self._clock.now() - asked_s
        if age > self.config.max_state_age_s:
            raise StaleStateError(
                f"{self.config.name} ({self.config.channel}): newest state is {age:.2f} s old; "
                "the control loop or a motor is silent, or the CAN adapter is that slow (yam-doctor)"
            )

    def _examined(self) -> ArmState:
        state, name = self.published(), self.config.name
        self._check_failed(state)
        if state.mode is Mode.OFF:
            raise LifeCycleError(f"{name}: the arm is off; connect again")
        if self.hardware.has_gripper and state.gripper_stops_rad is None:
            why = _WITHOUT_STOPS.get(state.mode, _CALIBRATE)
            raise GripperError(f"{name}: the gripper's stops are unknown, and so is its position; {why}")
        return state

    def _check_failed(self, state: ArmState) -> None:
        if state.mode in _FAILED and state.message:
            raise MotorError(f"{self.config.name} ({self.config.channel}): {state.message}")

    def track(
        self,
        q: Sequence[float] | np.ndarray,
        gripper: float | None = None,
        dq: Sequence[float] | np.ndarray | None = None,
        kp: Sequence[float] | np.ndarray | None = None,
        kd: Sequence[float] | np.ndarray | None = None,
    ) -> tuple[np.ndarray, float | None]:
        """Give a target; the loop moves the set-point there under its limits.

        Args:
            q: (n,) rad.
            gripper: 0 closed … 1 open; None keeps the present set-point.
            dq: (n,) rad/s with which the target moves, if known.
            kp, kd: (n,) gains for this target instead of the configured ones, Nm/rad and Nm s/rad.

        Returns:
            The joints and gripper position really asked for, after the limits; those held while the arm takes no
            targets: during an emergency stop, while the other arm is in trouble.

        Raises:
            ActionError: wrong shape, not finite, or more than a motor takes; nothing was sent.
            LifeCycleError: it floats or lands; nothing was sent.
            YamError: it has failed or is silent, see `observe`.
        """
        hw, config, n = self.hardware, self.config, self.hardware.joints
        name, relative = config.name, config.max_relative_target
        target: list[float] = finite_vector(name, "q", q, n).tolist()
        options = self._checked_options(dq=dq, kp=kp, kd=kd)
        if gripper is not None and hw.has_gripper:
            target.append(finite_number(name, "gripper", gripper))
        state = self.newest()
        mode = state.mode
        if mode is Mode.STOPPED:
            self._limit_log.note(Limited.EMERGENCY_STOP)
            return state.setpoint_q, state.gripper_setpoint
        if Limited.PEER in state.limited:
            return state.setpoint_q, state.gripper_setpoint
        if mode not in (Mode.HOLD, Mode.TRACK):
            raise LifeCycleError(f"{name}: takes no targets in mode {mode.name.lower()}; let it hold first")
        if len(target) < hw.n:
            assert state.gripper_setpoint is not None
            target.append(state.gripper_setpoint)
        measured = target
        if relative is not None:
            measured = list(state.positions)
        target, limited = limit_target(target, measured, self._lower, self._upper, relative)
        self._limit_log.note(limited)
        self._commands.aim(self._clock.now(), target, options)
        return np.array(target[:n]), target[-1] if hw.has_gripper else None

    def _checked_options(self, **given: Sequence[float] | np.ndarray | None) -> dict[str, np.ndarray]:
        """Speed and gains of a target, as far as they are given, (n,) each.

        Raises:
            ActionError: wrong shape, not finite, or more than a motor takes.
        """
        options = {}
        for field, value in given.items():
            if value is not None:
                options[field] = finite_vector(self.config.name, field, value, self.hardware.joints)
                check_range(self.config.name, field, options[field], *self._ranges[field])
        return options

    def hold(self) -> None:
        """Keep the present set-point, or the measured pose when floating.

        Raises:
            LifeCycleError: not from the present state.
        """
        self._request(Request.HOLD)

    def float(self) -> None:
        """Gravity-compensated free motion.

        Raises:
            LifeCycleError: not from the present state, or it would run away; a hand that pulls at it has one second to
                let go.
        """
        deadline = self._clock.now() + _LET_GO_S
        while True:
            try:
                return self._request(Request.FLOAT)
            except LifeCycleError:
                if self.mode() not in (Mode.HOLD, Mode.TRACK) or self._clock.now() > deadline:
                    raise
            self._clock.sleep(0.05)

    def land(self) -> None:
        """Begin to land; `mode()` becomes OFF when torque has been cut.

        Raises:
            LifeCycleError: the arm has failed and the emergency stop is latched.
        """
        self._request(Request.LAND)

    def rearm(self) -> None:
        """Enable again what has failed, and hold the measured pose; see `await_gripper`. Look at the arm first.

        Raises:
            LifeCycleError: it still fails, or needs a new connection; the message says which.
        """
        self._request(Request.REARM)

    def await_gripper(self, sought: bool = False) -> ArmState:
        """Wait until nobody seeks the gripper's stops any more.

        Args:
            sought: they were to be; False: only if they are just now.

        Returns:
            The arm's state then.

        Raises:
            MotorError: they are unknown still: the search has failed, was cut short, or does not end.
            StaleStateError: the control loop is silent.
        """
        name, deadline = self.config.name, self._clock.now() + _SEARCH_TIMEOUT_S
        while (state := self.published()).mode is Mode.BRING_UP:
            sought = True
            self._check_age(state.published_s)
            if self._clock.now() > deadline:
                raise MotorError(f"{name}: the search for the gripper's stops does not end")
            self._clock.sleep(0.02)
        self._check_failed(state)
        if sought and self.hardware.has_gripper and state.gripper_stops_rad is None:
            why = _WITHOUT_STOPS.get(state.mode, _CALIBRATE)
            raise MotorError(
                f"{name}: the search for the gripper's stops was cut short ({state.mode.name.lower()}); {why}"
            )
        return state

    @property
    def off(self) -> bool:
        """Whether its control loop has said that the arm has no torque any more."""
        try:
            return self.mode() is Mode.OFF
        except StaleStateError:  # it died in the middle of a write
            return False

    def bury(self) -> None:
        """Say what has become of an arm whose control process and stand-by have both died, and remove their files."""
        logger.critical("%s: nobody drives the arm; its motors have let go by themselves", self.config.name)
        with contextlib.suppress(OSError, YamError):
            lock = FileLock(lock_path(self._key), self.config.channel)
            lock.acquire()
            state_path(self._key).unlink(missing_ok=True)
            lock.release()

    def calibrate_gripper(self) -> None:
        """Search the gripper's stops anew and wait until they are found and stored.

        Raises:
            MotorError: there is no gripper motor, the search failed, or the arm was stopped or landed meanwhile.
            LifeCycleError: not from the present mode.
            GripperError: they are not stored in `calibration_path`; those that were found count until the arm is off.
        """
        self._request(Request.CALIBRATE_GRIPPER)
        stops = self.await_gripper(sought=True).gripper_stops_rad
        if self.config.calibration_path is not None:
            assert stops is not None
            await_stored(self.config.name, Path(self.config.calibration_path), self.hardware.gripper.name, *stops)

    def _request(self, request: Request) -> None:
        number = self._commands.request(request)
        deadline = self._clock.now() + _REQUEST_TIMEOUT_S
        while True:
            state = self.published()
            if state.answered == number:
                break
            if state.mode is Mode.OFF:
                if request is Request.LAND:
                    return
                raise LifeCycleError(f"{self.config.name}: the arm is off; connect again")
            if self._clock.now() > deadline:
                raise StaleStateError(f"{self.config.name}: the control loop does not answer")
            self._clock.sleep(0.001)
        if state.refusal is not None:
            raise LifeCycleError(state.refusal)
