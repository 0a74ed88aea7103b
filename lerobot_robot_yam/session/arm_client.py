"""Client for one arm of a session: reads the arm's state block, writes its command block."""

import dataclasses
import logging
import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from lerobot_robot_yam.arm.profile_files import gain_ranges
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.arm.validation import check_range, finite_floats, finite_number, finite_vector
from lerobot_robot_yam.control.gripper.gripper_stops import await_stored
from lerobot_robot_yam.control.gripper.trigger_range import learn, save_range
from lerobot_robot_yam.damiao.tables import motor_type
from lerobot_robot_yam.errors import LifeCycleError, MotorError, StaleStateError
from lerobot_robot_yam.session.caller_blocks import CommandWriter, StateReader, without_stops
from lerobot_robot_yam.session.target_limits import LimitLog, limit_target
from lerobot_robot_yam.state.arm_state import ArmState
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Descriptors, Led, Limited, Request
from lerobot_robot_yam.system.clock import SYSTEM, Clock

REQUEST_TIMEOUT_S = 1.0  # wait for the control loop's reply to a request, s
_LET_GO_S = 1.0  # time for a person to release an arm before it floats, s
_SEARCH_TIMEOUT_S = 20.0  # timeout of the search for the gripper's stops, s
_TRIGGER_S = 8.0  # time for a person to squeeze the trigger, s
_TRIGGER_POLL_S = 0.01  # polling interval of the trigger, s

Numbers = Sequence[float]
Vector = Numbers | np.ndarray

logger = logging.getLogger(__name__)


class ArmClient:
    """Client for one arm of a running session. Only one thread may write; any thread may read.

    Args:
        hardware: the arm.
        clock: clock of the arm's control loop.
        written: callback after each command is written.

    Attributes:
        published, await_fresh, await_next, newest: methods of the client's `StateReader`.
        kp, kd: (joints,) current default gains of the joints, Nm/rad and Nm s/rad.
    """

    def __init__(self, hardware: ResolvedArm, clock: Clock = SYSTEM, written: Callable[[], None] = lambda: None):
        self.hardware, self.config, self._clock = hardware, hardware.config, clock
        self._states = states = StateReader(hardware, clock)
        self.published, self.await_fresh, self.newest = states.published, states.await_fresh, states.newest
        self.await_next = states.await_next
        self._commands = CommandWriter(hardware.name, hardware.n, written)
        self._lower, self._upper = hardware.lower.tolist(), hardware.upper.tolist()
        self._motors = [motor_type(motor.type) for motor in hardware.motors[: hardware.joints]]
        self._limit_log = LimitLog(hardware.name)
        self.kp, self.kd = hardware.kp[: hardware.joints], hardware.kd[: hardware.joints]

    @property
    def descriptors(self) -> Descriptors:
        """File descriptors of both blocks, to pass to the control loop. Raises LifeCycleError: the client is closed."""
        return Descriptors(self._states.block.descriptor, self._commands.descriptor)

    def payload(self) -> bytes | None:
        """Return the newest state record as bytes, for forwarding; None before the first record.

        Raises:
            LifeCycleError: the client is closed.
        """
        return self._states.block.read_bytes()

    def close(self) -> None:
        """Close the state block and the command block. The arm keeps running."""
        self._commands.close()
        self._states.close()

    def mode(self) -> Mode:
        """Return the last published mode, however old the state is."""
        return self.published().mode

    def observe(self) -> ArmState:
        """Return the newest state of the arm, after waiting as `await_fresh` does.

        Raises:
            MotorError: a motor has a fault; the message names the motor.
            StaleStateError: the control loop or a motor has been silent for longer than `max_state_age_s`.
            GripperError: the gripper's position is unknown because its stops are unknown.
            LifeCycleError: the arm is not connected.
        """
        self.await_fresh()
        return self.newest()

    def write_target(
        self,
        q: Vector,
        gripper: float | None = None,
        dq: Vector | None = None,
        kp: Vector | None = None,
        kd: Vector | None = None,
        leader: str = "",
        take_over: tuple[int, int] = (0, 0),
        given_s: float | None = None,
    ) -> tuple[np.ndarray, float | None]:
        """Write a target. The control loop moves the set-point to the target within its limits.

        Args:
            q: (n,) joint target, rad.
            gripper: gripper target, 0 closed … 1 open; None keeps the current set-point.
            dq: (n,) velocity of the target, rad/s; see `YamArm.command`.
            kp, kd: (n,) gains for this target instead of the default gains, Nm/rad and Nm s/rad. They obey the rule
                of a configuration: kp from 1, kd from a fiftieth of kp, both up to the motor's largest.
            leader: channel key of the leader that produced the target; the control loop reads its later targets itself,
                until another target or request, at most for `command_timeout_s`. Empty: none.
            take_over: (number of this leader's button, from 1, its presses as far as the caller knows): the loop reads
                the leader's targets once the button has been pressed again, and obeys this target until then.
            given_s: timestamp of a target that another computer sent, in this clock's time, s; None: now.

        Returns:
            Joint and gripper target after the limits. While the arm ignores targets (emergency stop, fault of a peer):
            the joint and gripper set-points that the arm holds.

        Raises:
            ActionError: a value has the wrong shape, is not finite, or is outside a motor's range; nothing was sent.
            LifeCycleError: the arm floats or lands; nothing was sent.
            YamError: the arm is in fault or silent, see `observe`; nothing was sent.
        """
        hw, name, relative = self.hardware, self.config.name, self.config.max_relative_target
        target = finite_floats(name, "q", q, hw.joints)
        options = self._validated_options(dq=dq, kp=kp, kd=kd)
        if gripper is not None and hw.has_gripper:
            target.append(finite_number(name, "gripper", gripper))
        state = self.newest()
        mode = state.mode
        if mode is Mode.STOPPED:
            self._limit_log.note(Limited.EMERGENCY_STOP)
        if mode is Mode.STOPPED or Limited.PEER in state.limited:
            return state.setpoint_q, state.gripper_setpoint
        if mode not in (Mode.HOLD, Mode.TRACK):
            raise LifeCycleError(f"{name}: takes no targets in mode {mode.name.lower()}; let it hold first")
        if len(target) < hw.n:
            assert state.gripper_setpoint is not None
            target.append(state.gripper_setpoint)
        measured = target if relative is None else list(state.positions)
        target, limited = limit_target(target, measured, self._lower, self._upper, relative)
        self._limit_log.note(limited)
        now = self._clock.now()
        self._commands.write_target(now if given_s is None else given_s, target, options, Led(leader, *take_over))
        return np.array(target[: hw.joints]), target[-1] if hw.has_gripper else None

    def _validated_options(self, **given: Vector | None) -> dict[str, np.ndarray]:
        """Check the speed and gains (n,) of a target; the rule for gains is that of a configuration.

        Raises:
            ActionError: a speed is outside the motor's range, or a configuration with these gains would be refused.
        """
        name, joints = self.config.name, self.hardware.joints
        options = {key: finite_vector(name, key, value, joints) for key, value in given.items() if value is not None}
        if "dq" in options:
            fastest = np.array([row.velocity_max_rad_s for row in self._motors])
            check_range(name, "dq", options["dq"], -fastest, fastest)
        if "kp" in options or "kd" in options:  # one alone acts together with the arm's own
            gains = {"kp": self.kp, "kd": self.kd} | options
            for key, bounds in gain_ranges(self._motors, gains["kp"]).items():
                check_range(name, key, gains[key], *bounds)
        return options

    def hold(self) -> None:
        """Hold the set-point, or when floating the measured pose. Raises LifeCycleError: the mode forbids holding."""
        self._request(Request.HOLD)

    def guide(self, within_s: float = _LET_GO_S) -> None:
        """Float, with the gripper at its set-point. The arm holds when `command_timeout_s` passes without `guide_on`.

        Raises:
            LifeCycleError: see `float`.
        """
        self.float(Request.GUIDE, within_s)

    def guide_on(self, gripper: float | None = None) -> None:
        """Keep a guided arm floating. Raises ActionError: `gripper` is not finite.

        Args:
            gripper: gripper target, 0 closed … 1 open; None keeps the set-point.
        """
        target: list[float] = self.published().q.tolist()
        if gripper is not None:
            target.append(min(max(finite_number(self.config.name, "gripper", gripper), 0.0), 1.0))
        self._commands.write_target(self._clock.now(), target, {})

    def float(self, request: Request = Request.FLOAT, within_s: float = _LET_GO_S) -> None:
        """Compensate only gravity, so that a person can move the arm by hand.

        Args:
            request: FLOAT or GUIDE.
            within_s: time for a person who pulls at the arm to release it, s.

        Raises:
            LifeCycleError: the current mode forbids floating, or the arm would move away by itself.
        """
        deadline = self._clock.now() + within_s
        while True:
            try:
                return self._request(request)
            except LifeCycleError:
                if self.mode() not in (Mode.HOLD, Mode.TRACK) or self._clock.now() >= deadline:
                    raise
            self._clock.sleep(0.05)

    def land(self) -> None:
        """Start landing. `mode()` becomes OFF when torque has been cut.

        Raises:
            LifeCycleError: the arm is in fault while the emergency stop is latched.
        """
        self._request(Request.LAND)

    def change_gains(self, kp: Vector, kd: Vector) -> None:
        """Change the default gains of targets, over half a second. The arm still lands with the configured gains.

        Args:
            kp, kd: (joints,) gains, Nm/rad and Nm s/rad.

        Raises:
            ActionError, ConfigError: see `checked_gains`; nothing was sent.
            LifeCycleError: the arm lands, or is off.
            StaleStateError: the control loop does not reply.
        """
        own_gains = self.checked_gains(kp, kd)
        self._request(Request.GAINS, own_gains)
        j = self.hardware.joints
        self.kp, self.kd = np.array(own_gains[:j]), np.array(own_gains[self.hardware.n :][:j])

    def checked_gains(self, kp: Vector, kd: Vector) -> Numbers:
        """Check joint gains. Return the gains of all motors: kp, then kd, with NaN for the gripper.

        Raises:
            ActionError: gains have the wrong shape or are not finite.
            ConfigError: these gains would be refused in a configuration, for example because damping is too weak.
        """
        hw, name = self.hardware, self.config.name
        given = [finite_vector(name, what, value, hw.joints).tolist() for what, value in (("kp", kp), ("kd", kd))]
        ResolvedArm(dataclasses.replace(self.config, kp=given[0], kd=given[1]))
        gripper = [math.nan] * hw.has_gripper
        return [*given[0], *gripper, *given[1], *gripper]

    def cut_torque(self) -> None:
        """HAZARD: cut torque at once. An arm that is not in its rest pose falls. Afterwards the arm is off.

        Raises:
            LifeCycleError: the current mode forbids cutting torque.
        """
        self._request(Request.CUT_TORQUE)

    def rearm(self) -> None:
        """Re-enable motors after a fault and hold the measured pose; see `await_gripper`. Inspect the arm first.

        Raises:
            LifeCycleError: a motor is still in fault, or the arm has to be connected again; the message says which.
        """
        self._request(Request.REARM)

    def await_gripper(self, sought: bool = False) -> ArmState:
        """Wait until the search for the gripper's stops has ended. Return the arm's state at that time.

        Args:
            sought: whether a search was requested; False: wait only if a search is running.

        Raises:
            MotorError: the stops are still unknown because the search failed, was interrupted, or timed out.
            StaleStateError: the control loop is silent.
        """
        name, deadline = self.config.name, self._clock.now() + _SEARCH_TIMEOUT_S
        while (state := self.published()).mode is Mode.BRING_UP:
            sought = True
            self._states.check_age(state.published_s)
            if self._clock.now() > deadline:
                raise MotorError(f"{name}: the search for the gripper's stops does not end")
            self._clock.sleep(0.02)
        self._states.check_failed(state)
        if sought and self.hardware.has_gripper and state.gripper_stops_rad is None:
            mode, remedy = state.mode.name.lower(), without_stops(state.mode)
            raise MotorError(f"{name}: the search for the gripper's stops was cut short ({mode}); {remedy}")
        return state

    @property
    def off(self) -> bool:
        """Whether the control loop has published that the arm has no torque."""
        try:
            return self.mode() is Mode.OFF
        except StaleStateError:  # the loop died while writing a record
            return False

    def calibrate_gripper(self) -> None:
        """Search for the gripper's stops again. Wait until the stops are found and stored.

        Raises:
            MotorError: there is no gripper motor, the search failed, or the arm was stopped or landed before it ended.
            LifeCycleError: the current mode forbids a search.
            GripperError: the stops were not stored in `calibration_path`; they remain valid until the arm is off.
        """
        self._request(Request.CALIBRATE_GRIPPER)
        stops = self.await_gripper(sought=True).gripper_stops_rad
        if self.config.calibration_path is not None:
            assert stops is not None
            await_stored(self.config.name, Path(self.config.calibration_path), self.hardware.gripper.name, *stops)

    def calibrate_trigger(self) -> None:
        """Learn the range of the handle's trigger while a person squeezes the trigger; the next start uses the range.

        Raises:
            GripperError: nobody squeezed the trigger, or its range cannot be stored.
        """
        name, path, clock = self.config.name, self.config.calibration_path, self._clock
        assert path is not None
        logger.info("%s: squeeze the trigger fully and let it go, some times, within %g s", name, _TRIGGER_S)
        deadline, seen = clock.now() + _TRIGGER_S, []
        while clock.now() < deadline:
            trigger = self.newest().trigger
            seen.append(math.nan if trigger is None else trigger)
            clock.sleep(_TRIGGER_POLL_S)
        save_range(name, Path(path), self.hardware.gripper.name, learn(name, seen))

    def ask(self, request: Request, own_gains: Numbers = (), number: int | None = None) -> int:
        """Write a request without waiting. Return its number; the loop publishes handled numbers in `ArmState.answered`

        Args:
            request: action requested from the control loop.
            own_gains: gains for GAINS, as `checked_gains` returns them.
            number: number of the request, greater than that of the previous request; None: the next number.
        """
        return self._commands.write_request(self._clock.now(), request, own_gains, number)

    def _request(self, request: Request, own_gains: Numbers = ()) -> None:
        number = self.ask(request, own_gains)
        deadline = self._clock.now() + REQUEST_TIMEOUT_S
        while True:
            state = self.published()
            if state.answered == number:
                break
            if state.mode is Mode.OFF:
                if request in (Request.LAND, Request.CUT_TORQUE):
                    return
                raise LifeCycleError(f"{self.config.name}: the arm is off; connect again")
            if self._clock.now() > deadline:
                raise StaleStateError(f"{self.config.name}: the control loop does not answer")
            self._clock.sleep(0.001)
        if state.refusal is not None:
            raise LifeCycleError(state.refusal)
