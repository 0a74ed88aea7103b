"""The caller's handle on one arm: its state block to read, its command block to write."""

import logging
import math
from collections.abc import Sequence

import numpy as np

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.estop import EmergencyStop
from lerobot_robot_yam.arm.hardware import Hardware
from lerobot_robot_yam.arm.lifecycle import Mode
from lerobot_robot_yam.arm.safety import LimitLog, finite_vector, limit_target
from lerobot_robot_yam.arm.state import (
    COMMAND_DTYPE,
    COMMAND_STRUCT,
    GRIPPER,
    SLOTS,
    STATE_DTYPE,
    ArmState,
    Limited,
    Request,
    command_path,
    decode_state,
    lock_path,
    state_path,
)
from lerobot_robot_yam.clock import SYSTEM, Clock
from lerobot_robot_yam.errors import ChannelInUseError, GripperError, LifeCycleError, MotorError, StaleStateError
from lerobot_robot_yam.runtime import FileLock
from lerobot_robot_yam.shared_block import SharedBlock

logger = logging.getLogger(__name__)

_REQUEST_TIMEOUT_S = 1.0
_CALIBRATION_TIMEOUT_S = 20.0
_FAILED = (Mode.FAULT, Mode.LAND, Mode.OFF)  # with a message: not because the caller has asked for it
_READY = (Mode.HOLD, Mode.TRACK, Mode.FLOAT)
_ORPHAN_S = 1.0
_UNSET = [math.nan] * SLOTS


class ArmPort:
    """One arm of a running session. One thread writes; reading is free."""

    def __init__(self, config: ArmConfig, hardware: Hardware, key: str, clock: Clock = SYSTEM):
        self.config = config
        self.hardware = hardware
        self._key = key
        self._clock = clock
        self._commands = SharedBlock(command_path(key), COMMAND_DTYPE, create=True)
        self._states: SharedBlock | None = None
        self._lower, self._upper = hardware.lower.tolist(), hardware.upper.tolist()
        self._target_stamp_s, self._target_sequence, self._target = 0.0, 0, _UNSET
        self._options = {"dq": _UNSET, "kp": _UNSET, "kd": _UNSET}
        self._asked, self._request_sequence = Request.NONE, 0
        self._write()
        self._limit_log = LimitLog(config.name)
        self._stop = EmergencyStop()

    def attach(self) -> None:
        """Open the state block of the loop that now runs."""
        self._states = SharedBlock(state_path(self._key), STATE_DTYPE, create=False)

    def close(self) -> None:
        """Let go of the blocks; the arm is not touched."""
        self._commands.close()
        if self._states is not None:
            self._states.close()
            self._states = None

    def _raw(self) -> np.ndarray:
        record = None if self._states is None else self._states.read()
        if record is None:
            raise LifeCycleError(f"{self.config.name}: not connected")
        return record

    def mode(self) -> Mode:
        """Life-cycle state as last published, however old."""
        return Mode(int(self._raw()["mode"]))

    def observe(self) -> ArmState:
        """The newest state of the arm.

        Raises:
            MotorError: a motor has a fault; names it.
            StaleStateError: the control loop or a motor has been silent for longer than `max_state_age_s`.
            GripperError: its stops are unknown, so that its position is.
            LifeCycleError: not connected.
        """
        record, name = self._raw(), self.config.name
        state = decode_state(record, self.hardware.joints, self.hardware.has_gripper)
        if state.mode in _FAILED and state.message:
            raise MotorError(f"{name} ({self.config.channel}): {state.message}")
        if state.mode is Mode.OFF:
            raise LifeCycleError(f"{name}: the arm is off; connect again")
        if state.mode in _READY and self.hardware.has_gripper and math.isnan(record["gripper_stops_rad"][0]):
            raise GripperError(f"{name}: the gripper's stops are unknown; calibrate it (lerobot-calibrate)")
        now = self._clock.now()
        age = now - state.stamp_s
        if age > self.config.max_state_age_s:
            raise StaleStateError(
                f"{name} ({self.config.channel}): newest state is {age:.2f} s old; "
                "the control loop or a motor is silent"
            )
        return state

    def track(
        self,
        q: Sequence[float] | np.ndarray,
        gripper: float | None = None,
        dq: Sequence[float] | np.ndarray | None = None,
        kp: Sequence[float] | np.ndarray | None = None,
        kd: Sequence[float] | np.ndarray | None = None,
        state: ArmState | None = None,
    ) -> tuple[np.ndarray, float | None]:
        """Give a target; the loop moves the set-point there under its limits.

        Args:
            q: (6,) rad.
            gripper: 0 closed … 1 open; None keeps the present set-point.
            dq: (6,) rad/s with which the target moves, if known.
            kp, kd: (6,) gains for this target instead of the configured ones.
            state: measured state for `max_relative_target`; read when needed.

        Returns:
            The joints and gripper position really asked for, after the limits; those held during an emergency stop.

        Raises:
            ActionError: wrong shape or not finite; nothing was sent.
        """
        hw, config, n = self.hardware, self.config, self.hardware.joints
        name, relative = config.name, config.max_relative_target
        target: list[float] = finite_vector(name, "q", q, n).tolist()
        if self._stop.latched:  # what is held is what is asked for
            self._limit_log.note(Limited.EMERGENCY_STOP)
            state = self.observe()
            return state.setpoint_q, state.gripper_setpoint
        if state is None and (relative is not None or (hw.has_gripper and gripper is None)):
            state = self.observe()
        if hw.has_gripper:
            if gripper is None:
                assert state is not None and state.gripper_setpoint is not None
                gripper = state.gripper_setpoint
            target += finite_vector(name, "gripper", [gripper], 1).tolist()
        measured = target
        if relative is not None and state is not None:
            measured = [
                *state.q.tolist(),
                *([] if state.gripper is None else [state.gripper]),
            ]
        target, limited = limit_target(target, measured, self._lower, self._upper, relative)
        self._limit_log.note(limited)
        unset = [math.nan] * (GRIPPER - n)
        self._target = [*target[:n], *unset, target[-1] if hw.has_gripper else math.nan]
        for field, value in (("dq", dq), ("kp", kp), ("kd", kd)):
            if value is None:
                self._options[field] = _UNSET
            else:
                last = 0.0 if field == "dq" else math.nan
                self._options[field] = [
                    *finite_vector(name, field, value, n).tolist(),
                    *unset,
                    last,
                ]
        self._target_stamp_s = self._clock.now()
        self._target_sequence += 1
        self._write()
        return np.array(target[:n]), target[-1] if hw.has_gripper else None

    def _write(self) -> None:
        options = self._options
        self._commands.write_bytes(
            COMMAND_STRUCT.pack(
                self._target_stamp_s,
                self._target_sequence,
                *self._target,
                *options["dq"],
                *options["kp"],
                *options["kd"],
                self._asked,
                self._request_sequence,
            )
        )

    def hold(self) -> None:
        """Keep the present set-point, or the measured pose when floating.

        Raises:
            LifeCycleError: not from the present state.
        """
        self._request(Request.HOLD)

    def float(self) -> None:
        """Gravity-compensated free motion.

        Raises:
            LifeCycleError: not from the present state.
        """
        self._request(Request.FLOAT)

    def land(self) -> None:
        """Begin to land; `mode()` becomes OFF when torque has been cut."""
        self._request(Request.LAND)

    def rearm(self) -> None:
        """Enable again what has failed, and hold the measured pose. Look at the arm first.

        Raises:
            LifeCycleError: it still fails, or needs a new connection; the message says which.
        """
        self._request(Request.REARM)

    @property
    def done(self) -> bool:
        """True when nobody drives the arm any more: it is off, or its control loop has put its block away."""
        return self._states is None or not self._states.current or self.mode() is Mode.OFF

    @property
    def orphaned(self) -> bool:
        """True when control process and stand-by have both died: nobody drives the arm, and it is limp by now."""
        if self._states is None or self._clock.now() - float(self._raw()["stamp_s"]) < _ORPHAN_S:
            return False
        lock = FileLock(lock_path(self._key), self.config.channel)
        try:
            lock.acquire()
        except ChannelInUseError:
            return False
        lock.release()
        logger.critical("%s: nobody drives the arm; its motors have let go by themselves", self.config.name)
        self._states.close(remove=True)
        self._states = None
        return True

    def calibrate_gripper(self) -> None:
        """Search the gripper's stops anew and wait until they are found and stored.

        Raises:
            MotorError: there is no gripper motor, or the search failed.
        """
        self._request(Request.CALIBRATE_GRIPPER)
        deadline = self._clock.now() + _CALIBRATION_TIMEOUT_S
        while self.observe().mode is Mode.BRING_UP:
            if self._clock.now() > deadline:
                raise MotorError(f"{self.config.name}: the gripper calibration does not end")
            self._clock.sleep(0.02)

    def _request(self, request: Request) -> None:
        self._asked = request
        self._request_sequence += 1
        self._write()
        deadline = self._clock.now() + _REQUEST_TIMEOUT_S
        while True:
            state = self._raw()
            if state["request_sequence"] == self._request_sequence:
                break
            if Mode(int(state["mode"])) is Mode.OFF:
                if request is Request.LAND:
                    return
                raise LifeCycleError(f"{self.config.name}: the arm is off; connect again")
            if self._clock.now() > deadline:
                raise StaleStateError(f"{self.config.name}: the control loop does not answer")
            self._clock.sleep(0.001)
        if state["request_refused"]:
            raise LifeCycleError(bytes(state["refusal"]).decode(errors="replace"))
