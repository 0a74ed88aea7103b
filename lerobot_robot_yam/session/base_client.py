"""Client of the base of a session: reads its state block, writes its command block."""

import logging
import os
import threading
from collections.abc import Callable, Sequence

import numpy as np

from lerobot_robot_yam.arm.validation import finite_number, finite_vector
from lerobot_robot_yam.errors import ActionError, ConfigError, LifeCycleError, MotorError, StaleStateError
from lerobot_robot_yam.mobile.base_target import Frame
from lerobot_robot_yam.mobile.odometry import to_world
from lerobot_robot_yam.mobile.rail_config import RailConfig
from lerobot_robot_yam.mobile.rail_profile import SOFT_END_M, RailState, RailTarget
from lerobot_robot_yam.mobile.resolved_base import ResolvedBase
from lerobot_robot_yam.session.caller_blocks import await_record
from lerobot_robot_yam.state.base_records import BASE_COMMAND_DTYPE, BASE_STATE_DTYPE, BaseRequest, BaseState
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Descriptors
from lerobot_robot_yam.system.clock import SYSTEM, Clock
from lerobot_robot_yam.system.shared_block import SharedBlock, allocate

logger = logging.getLogger(__name__)

REQUEST_TIMEOUT_S = 1.0  # wait for the loop's answer to a request, s
_POLL_S, _HOMING_POLL_S = 0.001, 0.02
_POSE_MOST_M, _POSE_MOST_RAD = 1000.0, 1000.0  # maximum of a pose target: farther ones are typing errors
_FAILED = (Mode.FAULT, Mode.LAND, Mode.OFF)  # modes that mean failure when the state has a message
_LIMIT_SLACK = 1e-9


class BaseClient:
    """Client of a running base. Only one thread may write; any thread may read.

    Args:
        hardware: the base.
        clock: clock of the base's control loop.
        written: called after each command.
    """

    def __init__(self, hardware: ResolvedBase, clock: Clock = SYSTEM, written: Callable[[], None] = lambda: None):
        self.hardware, self.config, self._clock, self._written = hardware, hardware.config, clock, written
        self._states: SharedBlock | None = SharedBlock(None, BASE_STATE_DTYPE, False, allocate(BASE_STATE_DTYPE))
        self._commands = SharedBlock(None, BASE_COMMAND_DTYPE, create=True)
        self._record = np.zeros((), BASE_COMMAND_DTYPE)
        self._record["target_stamp_s"] = self._record["rail_stamp_s"] = self._record["request_stamp_s"] = -np.inf
        self._lock, self._pid = threading.Lock(), os.getpid()
        self._limited = False
        self._write()

    @property
    def _block(self) -> SharedBlock:
        if self._states is None:
            raise LifeCycleError(f"{self.config.name}: not connected")
        return self._states

    @property
    def descriptors(self) -> Descriptors:
        """File descriptors of both blocks, for the loop."""
        return Descriptors(self._block.descriptor, self._commands.descriptor)

    def close(self) -> None:
        """Close both blocks. Idempotent."""
        states, self._states = self._states, None
        if states is not None:
            states.close()
            self._commands.close()

    def published(self) -> BaseState:
        """Read the state as last published, however old or bad. Raises LifeCycleError: the base is not connected."""
        record = self._block.read()
        if record is None:
            raise LifeCycleError(f"{self.config.name}: not connected")
        return BaseState(record)

    def payload(self) -> bytes | None:
        """Return the newest state record as bytes, for forwarding; None before the first record."""
        return self._block.read_bytes()

    def await_next(self, after: int) -> int:
        """Wait for the state after number `after`; return the number of the newest state, see `await_record`."""
        period_s = 1.0 / self.config.rate_hz if self._clock is SYSTEM else 0.0
        return await_record(self._block, after, period_s, self._clock)

    def mode(self) -> Mode:
        """Read the last published mode, however old."""
        return self.published().mode

    def observe(self) -> BaseState:
        """Read the newest state.

        Raises:
            MotorError: the base has a fault; the message names the motor.
            StaleStateError: the control loop or a motor has been silent for longer than `max_state_age_s`.
            LifeCycleError: the base is not connected.
        """
        state, where = self.published(), f"{self.config.name} ({self.config.channel})"
        if state.mode in _FAILED and state.message:
            raise MotorError(f"{where}: {state.message}")
        if state.mode is Mode.OFF:
            raise LifeCycleError(f"{where}: the base is off; connect again")
        age_s = self._clock.now() - state.asked_s
        if age_s > self.config.max_state_age_s:
            raise StaleStateError(f"{where}: newest state is {age_s:.2f} s old; the loop or a motor is silent")
        return state

    def write_velocity(
        self, velocity: Sequence[float] | np.ndarray, frame: Frame = Frame.LOCAL, given_s: float | None = None
    ) -> np.ndarray:
        """Write a target twist (3,), m/s, m/s, rad/s. Repeat it at 10 Hz or faster, or the base brakes.

        given_s: time of a target that another computer sent, in this clock's time, s; None: now.

        Returns:
            The twist after the limits, with its direction; zero while the base takes no targets (emergency stop).

        Raises:
            ActionError: a value has a wrong shape or is not finite; nothing was sent.
            YamError: the base has failed or is silent, see `observe`; nothing was sent.
        """
        name, asked = self.config.name, finite_vector(self.config.name, "velocity", velocity, 3)
        if not isinstance(frame, Frame):
            raise ActionError(f"{name}: frame is {' or '.join(f.name.lower() for f in Frame)}, not {frame!r}")
        if not self._takes_targets():
            return np.zeros(3)
        share = float((np.abs(asked) / self.hardware.limits.velocity).max())
        limited = share > 1.0 + _LIMIT_SLACK
        if limited and not self._limited:
            logger.warning("%s: the velocity is limited to %s", name, self.hardware.limits.velocity)
        self._limited = limited
        sent = asked / share if limited else asked
        self._write_target(sent, frame, False, given_s)
        return sent

    def write_pose(
        self, pose: Sequence[float] | np.ndarray, frame: Frame = Frame.GLOBAL, given_s: float | None = None
    ) -> np.ndarray:
        """Write a target pose (3,), m, m, rad; see `write_velocity`.

        frame: GLOBAL, of the odometry; or LOCAL, relative to the present pose: write such a target once, and then
        repeat what this method returns with GLOBAL.

        Returns:
            The pose in the odometry's frame; the present pose while the base takes no targets (emergency stop).
        """
        name, target = self.config.name, finite_vector(self.config.name, "pose", pose, 3)
        if np.abs(target[:2]).max() > _POSE_MOST_M or abs(target[2]) > _POSE_MOST_RAD:
            raise ActionError(f"{name}: the pose {target.tolist()} is farther away than {_POSE_MOST_M:g} m or rad")
        here = self.observe().pose
        if frame is Frame.LOCAL:
            target = here + to_world(target, float(here[2]))
        if not self._takes_targets():
            return here
        self._write_target(target, Frame.GLOBAL, True, given_s)
        return target

    def write_rail_velocity(self, velocity: float, given_s: float | None = None) -> float:
        """Write a target velocity of the rail, m/s, positive up. Repeat it at 10 Hz or faster, or the rail brakes.

        given_s: see `write_velocity`.

        Returns:
            The velocity after the limit; 0 while the base takes no targets (emergency stop).

        Raises:
            ConfigError: the base has no rail.
            ActionError: the value is not a finite number; nothing was sent.
            LifeCycleError: the rail has not been homed, or homes now; nothing was sent.
            YamError: the base has failed or is silent, see `observe`; nothing was sent.
        """
        asked = finite_number(self.config.name, "rail velocity", velocity)
        most = self._rail_config().velocity_limit
        return self._write_rail(RailTarget(min(max(asked, -most), most)), 0.0, given_s)

    def write_rail_height(self, height: float, given_s: float | None = None) -> float:
        """Write a target height of the rail, m above the lower switch; see `write_rail_velocity`.

        Returns:
            The height within the soft ends; the present height while the base takes no targets (emergency stop).
        """
        asked = finite_number(self.config.name, "rail height", height)
        most = self._rail_config().stroke_m - SOFT_END_M
        target = RailTarget(min(max(asked, SOFT_END_M), most), True)
        return self._write_rail(target, self.rail_state().height_m, given_s)

    def rail_state(self) -> RailState:
        """Read the newest state of the rail. Raises YamError: see `observe`; ConfigError: the base has no rail."""
        self._rail_config()
        state = self.observe().rail
        assert state is not None
        return state

    def home_rail(self) -> None:
        """Drive the rail up to its upper and down to its lower switch, so that its height is known; wait for the end.

        Raises:
            LifeCycleError: the base cannot home now, or was told to stop meanwhile.
            MotorError: homing has failed; the message says why. The brake holds.
        """
        self._rail_config()
        self.request(BaseRequest.HOME_RAIL)
        try:
            while (state := self.rail_state()).homing:
                self._clock.sleep(_HOMING_POLL_S)
        except BaseException:
            if self.mode() in (Mode.HOLD, Mode.TRACK):
                self.hold()
            raise
        if not state.homed:
            raise LifeCycleError(f"{self.config.name}: rail: homing was stopped; home it again")

    def _rail_config(self) -> RailConfig:
        if self.config.rail is None:
            raise ConfigError(f"{self.config.name}: has no rail; give its configuration `rail`")
        return self.config.rail

    def _write_rail(self, target: RailTarget, instead: float, given_s: float | None) -> float:
        """Write a target, and return its value; return `instead` while the base takes no targets."""
        state = self.rail_state()
        if state.homing or not state.homed:
            why = "is homing" if state.homing else "is not homed; call home_rail(), if its way is free"
            raise LifeCycleError(f"{self.config.name}: rail: {why}")
        if not self._takes_targets():
            return instead
        with self._lock:
            record = self._record
            record["rail_value"], record["rail_height"] = target
            record["rail_stamp_s"] = self._clock.now() if given_s is None else given_s
            record["rail_sequence"] += 1
            self._write()
        return target.value

    def _takes_targets(self) -> bool:
        """Return whether targets may be sent; an emergency stop ignores them, other modes refuse them."""
        state = self.observe()
        if state.mode is Mode.STOPPED:
            return False
        if state.mode not in (Mode.HOLD, Mode.TRACK):
            raise LifeCycleError(f"{self.config.name}: takes no targets in mode {state.mode.name.lower()}")
        return True

    def _write_target(self, values: np.ndarray, frame: Frame, pose: bool, given_s: float | None) -> None:
        with self._lock:
            record = self._record
            record["values"], record["frame"], record["pose"] = values, frame, pose
            record["target_stamp_s"] = self._clock.now() if given_s is None else given_s
            record["target_sequence"] += 1
            self._write()

    def _write(self) -> None:
        if os.getpid() != self._pid:
            raise LifeCycleError(
                f"{self.config.name}: the base belongs to process {self._pid}, not to its forked child"
            )
        self._commands.write(self._record)
        self._written()

    def request(self, request: BaseRequest) -> None:
        """Have the loop carry out a request, and wait until it has.

        Raises:
            LifeCycleError: the loop has refused the request; the message says why.
            StaleStateError: the loop does not answer.
        """
        number = self.ask(request)
        deadline = self._clock.now() + REQUEST_TIMEOUT_S
        while (state := self.published()).answered != number:
            if state.mode is Mode.OFF:
                if request is BaseRequest.LAND:
                    return
                raise LifeCycleError(f"{self.config.name}: the base is off; connect again")
            if self._clock.now() > deadline:
                raise StaleStateError(f"{self.config.name}: the control loop does not answer")
            self._clock.sleep(_POLL_S)
        if state.refusal is not None:
            raise LifeCycleError(state.refusal)

    def ask(self, request: BaseRequest, number: int | None = None) -> int:
        """Write a request without waiting, and drop targets that the loop has not read yet. Return its number.

        number: number of the request, greater than that of the previous request; None: the next number.
        """
        with self._lock:
            record = self._record
            record["request"], record["request_stamp_s"] = request, self._clock.now()
            record["request_sequence"] = number or record["request_sequence"] + 1
            record["target_stamp_s"] = record["rail_stamp_s"] = -np.inf
            self._write()
            return int(record["request_sequence"])

    def hold(self) -> None:
        """Brake and stay."""
        self.request(BaseRequest.HOLD)

    def land(self) -> None:
        """Brake, then cut torque; does not wait for the end."""
        self.request(BaseRequest.LAND)

    def rearm(self) -> None:
        """Enable failed motors again, and take targets again. Raises LifeCycleError: a motor still fails."""
        self.request(BaseRequest.REARM)

    def reset_odometry(self) -> None:
        """Make the present pose the origin of the odometry."""
        self.request(BaseRequest.RESET_ODOMETRY)

    def await_gripper(self) -> None:
        """Do nothing: a base has no gripper."""

    @property
    def off(self) -> bool:
        """Whether the control loop has published that the base is without torque."""
        try:
            return self.mode() is Mode.OFF
        except StaleStateError:
            return False
