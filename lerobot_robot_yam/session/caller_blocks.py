"""Caller's side of an arm's shared memory: `StateReader` reads states, `CommandWriter` writes commands."""

import math
import os
import threading
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.errors import GripperError, LifeCycleError, MotorError, StaleStateError
from lerobot_robot_yam.state.arm_state import ArmState
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import COMMAND_DTYPE, NOT_LED, PUBLISHED, STATE_DTYPE, Led, Request, packed
from lerobot_robot_yam.system.clock import SYSTEM, Clock
from lerobot_robot_yam.system.shared_block import SharedBlock, allocate

_FAILED = (Mode.FAULT, Mode.LAND, Mode.OFF)  # modes that mean a failure if the state has a message
_WITHOUT_STOPS = {
    Mode.BRING_UP: "they are being sought; wait",
    Mode.STOPPED: "they are sought when the emergency stop is released (yam-estop release)",
}
_NEARLY_S = 0.0013  # maximum time to wait for a state that is due, s; the newest state is then nearly one tick old
_LATE_S = 0.003  # wait for an overdue state, s; the loop waits up to 2 ms for a motor's reply
_OLD_S = 0.0025  # age beyond one tick from which a sample counts as old, s: a newer sample is due
_AFTER_S = 0.0003  # sleep beyond a tick's due time, s: nearly all states are published by then, so polling is rare
_POLL_S = 0.00005  # polling interval of the block's sequence number, s
_GRIPPER_OPTIONS = {"dq": 0.0, "kp": math.nan, "kd": math.nan}  # default speed and gains of the gripper in a target


def without_stops(mode: Mode) -> str:
    """Return the remedy, in this mode, for a gripper whose stops are unknown."""
    return _WITHOUT_STOPS.get(mode, "calibrate it (lerobot-calibrate)")


class StateReader:
    """Reader of the states that the control loop publishes. Thread-safe."""

    def __init__(self, hardware: ResolvedArm, clock: Clock):
        self._config, self._has_gripper, self._clock = hardware.config, hardware.has_gripper, clock
        self._block: SharedBlock | None = SharedBlock(None, STATE_DTYPE, False, allocate(STATE_DTYPE))
        self._period_s = 1.0 / self._config.rate_hz if self._config.rate_hz > 0 and clock is SYSTEM else 0.0
        self._newest: tuple[int, ArmState] | None = None  # (sequence number, newest state that passed the checks)

    @property
    def block(self) -> SharedBlock:
        """Shared memory with the state. Raises LifeCycleError: the reader is closed."""
        if self._block is None:
            raise LifeCycleError(f"{self._config.name}: not connected")
        return self._block

    def close(self) -> None:
        """Close the block. Idempotent."""
        block, self._block = self._block, None
        if block is not None:
            block.close()

    def published(self) -> ArmState:
        """Return the last published state without any check. Raises LifeCycleError: the arm is not connected."""
        payload = self.block.read_bytes()
        if payload is None:
            raise LifeCycleError(f"{self._config.name}: not connected")
        return ArmState(payload)

    def await_fresh(self) -> None:
        """Wait for a state that is due within 1.3 ms; if its tick lost a motor's reply, wait for the next state.

        The wait lasts at most two ticks and a few milliseconds; it ends early if a motor missed more replies. To
        observe several arms, first call `await_fresh` for each: a state ages during the wait for another arm.

        Raises:
            YamError: see `newest`.
        """
        period_s = self._period_s
        if not period_s or self._block is None:
            return
        self._await_tick(self._block, self._block.sequence(), _NEARLY_S)
        age_s = self._clock.now() - self.newest().stamp_s
        if self._newest is not None and period_s + _OLD_S < age_s < 2.0 * period_s + _OLD_S:
            self._await_tick(self._block, self._newest[0], period_s)

    def await_next(self, after: int) -> int:
        """Wait for the state after number `after`, unless the loop is late. Return the number of the newest state.

        Raises:
            LifeCycleError: the arm is not connected.
        """
        return await_record(self.block, after, self._period_s, self._clock)

    def _await_tick(self, block: SharedBlock, sequence: int, within_s: float) -> None:
        """Wait for the record after `sequence` if it is due within `within_s`; give up if the record is late."""
        due_s = block.peek(*PUBLISHED) + self._period_s
        if due_s - within_s < self._clock.now():
            _await_until(block, sequence, due_s, self._clock)

    def newest(self) -> ArmState:
        """Return the newest state, without waiting. Raises YamError: see `ArmClient.observe`."""
        newest = self._newest
        # read before the record: the record may be newer than this number, never older
        sequence = self.block.sequence()
        if newest is None or newest[0] != sequence:  # unpack each record only once
            newest = self._newest = (sequence, self._examined())
        state = newest[1]
        self.check_age(state.asked_s)
        return state

    def _examined(self) -> ArmState:
        state, name = self.published(), self._config.name
        self.check_failed(state)
        if state.mode is Mode.OFF:
            raise LifeCycleError(f"{name}: the arm is off; connect again")
        if self._has_gripper and state.gripper_stops_rad is None:
            raise GripperError(
                f"{name}: the gripper's stops are unknown, and so is its position; {without_stops(state.mode)}"
            )
        return state

    def check_age(self, since_s: float) -> None:
        """Check the age of a state with timestamp `since_s` (of its samples or of its publication).

        Raises:
            StaleStateError: the timestamp is older than `max_state_age_s`.
        """
        age = self._clock.now() - since_s
        if age > self._config.max_state_age_s:
            raise StaleStateError(
                f"{self._config.name} ({self._config.channel}): newest state is {age:.2f} s old; "
                "the control loop or a motor is silent, or the CAN adapter is that slow (yam-doctor)"
            )

    def check_failed(self, state: ArmState) -> None:
        """Raise MotorError if the state belongs to a failed arm; the message gives the cause."""
        if state.mode in _FAILED and state.message:
            raise MotorError(f"{self._config.name} ({self._config.channel}): {state.message}")


def await_record(block: SharedBlock, after: int, period_s: float, clock: Clock) -> int:
    """Wait for the state record after number `after`, unless the loop is late. Return the number of the newest record.

    Args:
        block: states of an arm or of a base.
        period_s: period of the control loop, s; 0: unknown, then this function does not wait.
    """
    if period_s and block.sequence() == after:
        due_s = block.peek(*PUBLISHED) + period_s
        clock.sleep(max(0.0, due_s + _AFTER_S - clock.now()))
        _await_until(block, after, due_s, clock)
    return block.sequence()


def _await_until(block: SharedBlock, sequence: int, due_s: float, clock: Clock) -> None:
    """Wait for the record after `sequence`, which is due at `due_s`; give up if it is late."""
    while block.sequence() == sequence and clock.now() < due_s + _LATE_S:
        clock.sleep(_POLL_S)


class CommandWriter:
    """Writer of one arm's command block. Thread-safe: one thread may stream targets while another re-arms.

    A forked child must not write: its copy could repeat commands that the parent has withdrawn.

    Args:
        name: name of the arm, for messages.
        motors: number of motors, including the gripper's.
        written: callback after each record is written.
    """

    def __init__(self, name: str, motors: int, written: Callable[[], None] = lambda: None):
        self._name, self._pid, self._written = name, os.getpid(), written
        self._lock = threading.Lock()
        self._block = SharedBlock(None, COMMAND_DTYPE, create=True)
        self._pack = packed(COMMAND_DTYPE, motors)[0].pack
        self._unset = [math.nan] * motors
        self._stamp_s, self._number, self._target = 0.0, 0, self._unset
        self._led = NOT_LED
        self._options = [self._unset] * len(_GRIPPER_OPTIONS)
        self._own = [*self._unset, *self._unset]
        self._asked, self._requests, self._asked_s = Request.NONE, 0, -math.inf
        self._write()

    @property
    def descriptor(self) -> int:
        """File descriptor of the block's memory."""
        return self._block.descriptor

    def close(self) -> None:
        self._block.close()

    def write_target(
        self,
        stamp_s: float,
        target: Sequence[float],
        options: Mapping[str, np.ndarray],
        led: Led = NOT_LED,
    ) -> None:
        """Write a target with timestamp `stamp_s` (time on the clock).

        Args:
            target: joints in rad, then the gripper, 0 closed … 1 open, if the arm has one.
            options: optional dq (rad/s), kp (Nm/rad) and kd (Nm s/rad) of the joints.
            led: leader whose later targets the loop reads itself.

        Raises:
            LifeCycleError: the arm belongs to another process.
        """
        rows = [
            [*options[field].tolist(), last][: len(target)] if field in options else self._unset
            for field, last in _GRIPPER_OPTIONS.items()
        ]
        self._check_process()
        with self._lock:
            self._target, self._options = list(target), rows
            self._stamp_s, self._led = stamp_s, led
            self._number += 1
            self._write()

    def write_request(
        self, stamp_s: float, request: Request, own_gains: Sequence[float] = (), number: int | None = None
    ) -> int:
        """Write a request and return its number. A target that the loop has not read yet is dropped.

        Args:
            stamp_s: time of the request on the clock, s.
            request: action requested from the control loop.
            own_gains: gains for GAINS: kp of all motors, then kd.
            number: number of the request, greater than that of the previous request; None: the next number.

        Raises:
            LifeCycleError: the arm belongs to another process.
        """
        self._check_process()
        with self._lock:
            self._asked, self._asked_s = request, stamp_s
            self._own = list(own_gains) or self._own
            self._requests = number or self._requests + 1
            self._stamp_s = -math.inf
            self._write()
            return self._requests

    def _check_process(self) -> None:
        if os.getpid() != self._pid:
            raise LifeCycleError(
                f"{self._name}: the arm belongs to process {self._pid}; its forked child {os.getpid()} may watch it, "
                "but not drive it"
            )

    def _write(self) -> None:
        values: list[object] = [
            self._stamp_s,
            self._number,
            *self._target,
            *(value for row in self._options for value in row),
            *self._own,
        ]
        values += [self._led.leader.encode(), *self._led[1:], self._asked_s, self._asked, self._requests]
        self._block.write_bytes(self._pack(*values))
        self._written()
