"""One arm in plain Python, for people who do not come through LeRobot.

    from lerobot_robot_yam.session.yam_arm import YamArm

    with YamArm(channel="can_follower_l") as arm:      # on leaving, the arm lands and torque is cut
        arm.move_to([0, 1.0, 1.0, 0, 0, 0], gripper=1.0)
        print(arm.observe().q)

With `interface="yam_sim", channel="follower_left"` the same lines drive the virtual rig.
"""

import dataclasses
import math
from typing import Any

import numpy as np

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.joint_map import RANGE_TOLERANCE_RAD
from lerobot_robot_yam.arm.validation import finite_vector
from lerobot_robot_yam.control.safety.progress_monitor import far_behind
from lerobot_robot_yam.errors import ActionError, ConfigError, LifeCycleError
from lerobot_robot_yam.session.arm_client import Vector
from lerobot_robot_yam.session.arm_session import ArmSession, Isolation
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import ArmState
from lerobot_robot_yam.system.clock import Clock
from lerobot_robot_yam.system.uncopyable import Uncopied

_STREAM_S = 0.02
_SETTLE_TIMEOUT_S = 2.0


class YamArm(Uncopied):
    """A YAM arm on one CAN channel. SI units; gripper 0 closed … 1 open.

    Args:
        config: the arm; or give its fields as keywords.
        isolation: where the control loop runs, see `ArmSession`.

    Raises:
        ConfigError: unknown field, arm, gripper or impossible value.
    """

    def __init__(self, config: ArmConfig | None = None, *, isolation: Isolation = "process", **fields: Any):
        unknown = set(fields) - {field.name for field in dataclasses.fields(ArmConfig)}
        if unknown:
            raise ConfigError(f"ArmConfig has no field {sorted(unknown)}")
        self.config = ArmConfig(**fields) if config is None else dataclasses.replace(config, **fields)
        self._session = ArmSession([self.config], isolation)

    def connect(self) -> "YamArm":
        """Bring the arm up; it then holds its pose (or floats, with `start="float"`). Returns itself.

        Raises:
            YamError: what failed; nothing is energised.
        """
        self._session.start()
        return self

    def close(self) -> None:
        """Land, cut torque, let go. Idempotent."""
        self._session.stop()

    def __enter__(self) -> "YamArm":
        return self if self._session.running else self.connect()

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def connected(self) -> bool:
        """True between `connect` and `close`."""
        return self._session.running

    @property
    def clock(self) -> Clock:
        """The clock by which the arm lives: the computer's, or that of a rig in lock-step."""
        return self._session.clock

    def observe(self) -> ArmState:
        """The newest state. Raises StaleStateError, MotorError, LifeCycleError: see `ArmClient.observe`."""
        return self._session[self.config.name].observe()

    def command(
        self,
        q: Vector,
        gripper: float | None = None,
        dq: Vector | None = None,
        kp: Vector | None = None,
        kd: Vector | None = None,
    ) -> np.ndarray:
        """Give one target; repeat it at 10 Hz or faster, or the arm comes to rest.

        Args:
            q: (n,) rad. dq: (n,) rad/s, the target's own speed. kp, kd: (n,) gains for this target.
            gripper: 0 closed … 1 open, None keeps it.

        Returns:
            (n,) what was really asked for after the limits.

        Raises:
            ActionError: wrong shape, not finite, or more than a motor takes; nothing was sent.
            YamError: it floats, has failed or is silent; nothing was sent.
        """
        return self._session[self.config.name].write_target(q, gripper, dq, kp, kd)[0]

    def move_to(self, q: Vector, gripper: float | None = None, speed_rad_s: float = 0.8) -> ArmState:
        """Go to a pose along a straight joint line with half-cosine speed, and wait until it is reached.

        q(t) = q0 + (1 − cos(π t / T)) / 2 · (q1 − q0), peak speed π/2 · |q1 − q0| / T = `speed_rad_s`.

        Raises:
            ActionError: wrong shape, not finite, or beyond a joint's range; nothing moves.
            LifeCycleError: the pose was not reached (obstructed, stopped, or limits hold the arm back).
        """
        port = self._session[self.config.name]
        state = port.observe()
        start = state.setpoint_q.copy() if state.mode is not Mode.FLOAT else state.q.copy()
        goal = finite_vector(self.config.name, "q", q, len(start))
        hw = port.hardware
        joints, lower, upper = hw.joints, hw.lower[: hw.joints], hw.upper[: hw.joints]
        beyond = (goal < lower - RANGE_TOLERANCE_RAD) | (goal > upper + RANGE_TOLERANCE_RAD)  # no arm measures so
        if beyond.any():
            joint = int(beyond.argmax())
            reach = f"{lower[joint]:.2f} … {upper[joint]:.2f} rad"
            name = hw.motors[joint].name
            raise ActionError(f"{self.config.name}: {name} cannot go to {goal[joint]:.2f} rad, only within {reach}")
        if state.mode is Mode.FLOAT:
            port.hold()
        first_grip = state.gripper_setpoint
        way_s = float(np.abs(goal - start).max(initial=0.0)) / speed_rad_s
        if gripper is not None and first_grip is not None:
            way_s = max(way_s, abs(gripper - first_grip) / hw.speed_limit[-1])
        reach_s = max(math.pi / 2 * way_s, 0.2)
        clock = self.clock
        begin = clock.now()
        while True:
            elapsed = clock.now() - begin
            share = 0.5 - 0.5 * math.cos(math.pi * min(elapsed / reach_s, 1.0))
            grip = None if gripper is None or first_grip is None else first_grip + share * (gripper - first_grip)
            asked, asked_grip = port.write_target(start + share * (goal - start), grip)
            state = port.observe()
            if state.mode not in (Mode.HOLD, Mode.TRACK):
                mode = state.mode.name.lower()
                raise LifeCycleError(f"{self.config.name}: pose not reached, the arm is in mode {mode}")
            behind = np.abs(state.setpoint_q - asked)
            if asked_grip is not None and state.gripper_setpoint is not None:
                behind = np.append(behind, abs(state.gripper_setpoint - asked_grip))
            late = behind >= 1e-3
            late[:joints] |= far_behind(state.q - goal, hw.kp[:joints], hw.torque_limit_nm[:joints])
            if elapsed >= reach_s and not late.any():
                return state
            if elapsed > reach_s + _SETTLE_TIMEOUT_S:
                name = hw.motors[int(late.argmax())].name
                raise LifeCycleError(f"{self.config.name}: pose not reached, {name} is obstructed or held back")
            clock.sleep(_STREAM_S)

    def hold(self) -> None:
        """Keep the present pose."""
        self._session[self.config.name].hold()

    def float(self) -> None:
        """Gravity-compensated: free to be moved by hand."""
        self._session[self.config.name].float()

    def rearm(self) -> None:
        """After a fault: enable the motors again and hold the measured pose. Look at the arm first.

        Raises:
            LifeCycleError: it still fails, or needs a new connection.
        """
        self._session.rearm()

    def land(self) -> None:
        """Bring the arm down and cut torque; waits. Afterwards only `close` is possible."""
        self._session.land()
