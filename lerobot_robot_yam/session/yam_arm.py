"""One arm in plain Python, without LeRobot.

    from lerobot_robot_yam.session.yam_arm import YamArm

    with YamArm(channel="can_follower_l") as arm:      # on leaving, the arm lands and torque is cut
        arm.move_to([0, 1.0, 1.0, 0, 0, 0], gripper=1.0)
        print(arm.observe().q)

With `interface="yam_sim", channel="follower_left"` the same lines drive the virtual rig.
"""

import dataclasses
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.joint_map import RANGE_TOLERANCE_RAD
from lerobot_robot_yam.arm.validation import finite_number, finite_vector
from lerobot_robot_yam.errors import ActionError, ConfigError, LifeCycleError
from lerobot_robot_yam.session.arm_client import ArmClient, Vector
from lerobot_robot_yam.session.arm_info import ArmInfo
from lerobot_robot_yam.session.arm_session import ArmSession, Isolation
from lerobot_robot_yam.session.playback import Playback, approach_s, ready, replay
from lerobot_robot_yam.session.state_recorder import StateRecorder, recording
from lerobot_robot_yam.session.trajectory import Trajectory, soft_way, soft_way_s
from lerobot_robot_yam.session.uncopyable import Uncopied
from lerobot_robot_yam.state.arm_state import ArmState
from lerobot_robot_yam.system.clock import Clock
from lerobot_robot_yam.system.paths import user_path

_STREAM_S = 0.02  # interval between targets of a motion, s
_SETTLE_TIMEOUT_S = 2.0  # timeout for joints to settle at the end of a motion, s
_LIES_RAD = 0.15  # distance from the rest pose within which cutting torque is safe, rad: the arm falls a finger's width


class YamArm(Uncopied):
    """YAM arm on one CAN channel. SI units; gripper 0 closed … 1 open.

    Args:
        config: configuration of the arm; alternatively pass its fields as keywords.
        isolation: where the control loop runs, see `ArmSession`.

    Raises:
        ConfigError: a field, the arm or the gripper is unknown, or a value is invalid.
    """

    def __init__(self, config: ArmConfig | None = None, *, isolation: Isolation = "process", **fields: Any):
        unknown = set(fields) - {field.name for field in dataclasses.fields(ArmConfig)}
        if unknown:
            raise ConfigError(f"ArmConfig has no field {sorted(unknown)}")
        self.config = ArmConfig(**fields) if config is None else dataclasses.replace(config, **fields)
        self._session = ArmSession([self.config], isolation)

    def connect(self) -> "YamArm":
        """Bring the arm up, so that it holds its pose (or floats, with `start="float"`). Return this object.

        Raises:
            YamError: bring-up failed; the arm is not energised.
        """
        self._session.start()
        return self

    def close(self) -> None:
        """Land, cut torque, end the session. Idempotent."""
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
        """Clock of the arm's control loop: the system clock, or the clock of a rig in lock-step."""
        return self._session.clock

    @property
    def _client(self) -> ArmClient:
        return self._session[self.config.name]

    def info(self) -> ArmInfo:
        """Return the arm's hardware and settings. Raises LifeCycleError: the arm is not connected."""
        return ArmInfo.of(self._client)

    def observe(self) -> ArmState:
        """Return the newest state. Raises StaleStateError, MotorError, LifeCycleError: see `ArmClient.observe`."""
        return self._client.observe()

    @contextmanager
    def recording(self, path: str | Path | None = None) -> Iterator[StateRecorder]:
        """Record every state into a `StateRecorder` while the block runs.

        Args:
            path: .npz file to write at the end, see `StateRecorder.save`; None: write no file.

        Raises:
            LifeCycleError: the arm is not connected.
            ConfigError: the file cannot be written.
        """
        with recording([self._client]) as recorder:
            yield recorder
        if path is not None:
            recorder.save(user_path(path))

    def command(
        self,
        q: Vector,
        gripper: float | None = None,
        dq: Vector | None = None,
        kp: Vector | None = None,
        kd: Vector | None = None,
    ) -> np.ndarray:
        """Write one target. Repeat it at 10 Hz or faster; otherwise the arm comes to rest.

        Args:
            q: (n,) joint target, rad.
            dq: (n,) velocity of the target, rad/s. Targets that agree with `dq` (to 0.01 rad) are tracked without lag:
                the last target is extrapolated until the next is due. Other targets are reached one period late.
            gripper: gripper target, 0 closed … 1 open; None keeps the current set-point.
            kp, kd: (n,) gains for this target: kp from 1 Nm/rad, kd from a fiftieth of kp, as in a configuration.

        Returns:
            Target (n,) after the limits, rad.

        Raises:
            ActionError: a value has the wrong shape, is not finite, or is outside a motor's range; nothing was sent.
            YamError: the arm floats, is in fault or silent; nothing was sent.
        """
        return self._client.write_target(q, gripper, dq, kp, kd)[0]

    def move_to(self, q: Vector, gripper: float | None = None, speed_rad_s: float = 0.8) -> ArmState:
        """Move to a pose along a straight joint-space line with half-cosine profile, and wait until the arm is there.

        Args:
            q: (n,) joint goal, rad.
            gripper: gripper goal, 0 closed … 1 open; None keeps the current set-point.
            speed_rad_s: peak speed of the fastest joint.

        Raises:
            ActionError: a value has the wrong shape, is not finite, or is outside a joint's range; nothing moves.
            LifeCycleError: the pose was not reached (obstructed, stopped, or held back by limits).
        """
        goal = self._goal(q, gripper)
        hw = self._client.hardware
        speed = np.concatenate([np.full(hw.joints, speed_rad_s), hw.speed_limit[hw.joints :]])
        start = ready([self._client])
        goal = np.where(np.isnan(goal), start, goal)
        return self._play(Playback([self._client], soft_way(start, goal, approach_s(goal - start, speed))))

    def move_joints(self, q: Vector, time_s: float, gripper: float | None = None) -> ArmState:
        """Move to a pose in `time_s` along a straight joint-space line with half-cosine profile; wait for the end.

        Args:
            q: (n,) joint goal, rad.
            time_s: duration of the motion, s.
            gripper: gripper goal, 0 closed … 1 open; None keeps the current set-point.

        Raises:
            ActionError: see `move_to`; also if `time_s` is too short for the speed and acceleration limits (the message
                has the minimum). Nothing moves.
            LifeCycleError: see `move_to`.
        """
        name, hw = self.config.name, self._client.hardware
        goal, seconds = self._goal(q, gripper), finite_number(name, "time_s", time_s)
        start = np.array(self._client.observe().setpoints)
        goal = np.where(np.isnan(goal), start, goal)
        acceleration = np.append(hw.acceleration_limit, [np.inf] * hw.has_gripper)
        least = max(soft_way_s(goal - start, hw.speed_limit, acceleration), _STREAM_S)
        if seconds < least:
            raise ActionError(
                f"{name}: it takes {least:.2f} s at least, not {seconds:g}: give time_s more; nothing moves"
            )
        return self._play(Playback([self._client], soft_way(ready([self._client]), goal, seconds)))

    def replay(self, trajectory: Trajectory) -> ArmState:
        """Move softly to the start of the trajectory, then along it, and wait until the arm is at its end.

        The arm slows down where the trajectory exceeds the speed limits. `track_integral` reduces the tracking error.
        `load_trajectory` and `save_trajectory` of `session/trajectory_file.py` read and write files.

        Raises:
            ActionError: the trajectory has other joints than the arm, or exceeds a joint's range; nothing moves.
            LifeCycleError: see `move_to`.
        """
        return self._play(replay([self._client], trajectory))

    def _goal(self, q: Vector, gripper: float | None) -> np.ndarray:
        """Check a goal. Return it as (n,) motors, NaN for a gripper that stays. Raises ActionError: see `move_to`."""
        name, hw = self.config.name, self._client.hardware
        goal = finite_vector(name, "q", q, hw.joints)
        lower, upper = hw.lower[: hw.joints], hw.upper[: hw.joints]
        beyond = (goal < lower - RANGE_TOLERANCE_RAD) | (goal > upper + RANGE_TOLERANCE_RAD)
        if beyond.any():
            joint = int(beyond.argmax())
            reach = f"{lower[joint]:.2f} … {upper[joint]:.2f} rad"
            raise ActionError(
                f"{name}: {hw.joint_names[joint]} cannot go to {goal[joint]:.2f} rad, only within {reach}"
            )
        if not hw.has_gripper:
            return goal
        grip = np.nan if gripper is None else min(max(finite_number(name, "gripper", gripper), 0.0), 1.0)
        return np.append(goal, grip)

    def _play(self, playback: Playback) -> ArmState:
        clock, ended_s = self.clock, None
        while True:
            if playback.step(clock.now()):
                late = playback.late()
                if not late:
                    return self.observe()
                ended_s = clock.now() if ended_s is None else ended_s
                if clock.now() > ended_s + _SETTLE_TIMEOUT_S:
                    raise LifeCycleError(f"{late}: pose not reached, it is obstructed or held back")
            clock.sleep(_STREAM_S)

    def hold(self) -> None:
        """Hold the current pose."""
        self._client.hold()

    def float(self) -> None:
        """Compensate only gravity, so that a person can move the arm by hand."""
        self._client.float()

    def update_kp_kd(self, kp: Vector, kd: Vector) -> None:
        """Change the joint gains, over half a second. The arm still lands with the configured gains.

        Args:
            kp, kd: (n,) gains, Nm/rad and Nm s/rad.

        Raises:
            ActionError, ConfigError: these gains would be refused in a configuration; nothing changes.
            LifeCycleError: the arm lands, or is off.
        """
        self._client.change_gains(kp, kd)

    def zero_torque(self, force: bool = False) -> None:
        """Cut torque without landing. Afterwards only `close` is possible.

        HAZARD: with `force` an arm in the air falls at once, with any object in its gripper.

        Raises:
            LifeCycleError: the arm is not in its rest pose and `force` is not set, or its mode forbids cutting torque.
            YamError: the pose is unknown because the arm is in fault or silent, and `force` is not set.
        """
        client = self._client
        if client.off:
            return
        hw = client.hardware
        if not force and not (hw.lies_at_rest and bool((np.abs(self.observe().q - hw.rest_q) < _LIES_RAD).all())):
            raise LifeCycleError(
                f"{self.config.name}: it would fall: it does not lie at rest. Land it (`land`), or support it and give "
                "force=True"
            )
        client.cut_torque()

    def rearm(self) -> None:
        """Re-enable motors after a fault and hold the measured pose. Inspect the arm first.

        Raises:
            LifeCycleError: a motor is still in fault, or the arm has to be connected again.
        """
        self._session.rearm()

    def land(self) -> None:
        """Land the arm and wait until torque is cut. Afterwards only `close` is possible."""
        self._session.land()
