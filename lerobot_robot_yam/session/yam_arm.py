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
from lerobot_robot_yam.control.joints.arm_set_point import ACCELERATION_LIMIT_RAD_S2
from lerobot_robot_yam.errors import ActionError, ConfigError, LifeCycleError
from lerobot_robot_yam.session.arm_client import ArmClient, Vector
from lerobot_robot_yam.session.arm_info import ArmInfo
from lerobot_robot_yam.session.arm_session import ArmSession, Isolation
from lerobot_robot_yam.session.playback import Playback, approach_s, ready, replay
from lerobot_robot_yam.session.state_recorder import StateRecorder, recording
from lerobot_robot_yam.session.trajectory import Trajectory, soft_way, soft_way_s
from lerobot_robot_yam.state.records import ArmState
from lerobot_robot_yam.system.clock import Clock
from lerobot_robot_yam.system.paths import user_path
from lerobot_robot_yam.system.uncopyable import Uncopied

_STREAM_S = 0.02  # period of the targets of a motion, s
_SETTLE_TIMEOUT_S = 2.0  # wait for joints to reach the end of a motion, s
_LIES_RAD = 0.15  # distance from the rest pose within which an arm lies, rad: its fall is a finger's width


class YamArm(Uncopied):
    """YAM arm on one CAN channel. SI units; gripper 0 closed … 1 open.

    Args:
        config: configuration of the arm; or give its fields as keywords.
        isolation: where the control loop runs, see `ArmSession`.

    Raises:
        ConfigError: a field, the arm or the gripper is unknown, or a value impossible.
    """

    def __init__(self, config: ArmConfig | None = None, *, isolation: Isolation = "process", **fields: Any):
        unknown = set(fields) - {field.name for field in dataclasses.fields(ArmConfig)}
        if unknown:
            raise ConfigError(f"ArmConfig has no field {sorted(unknown)}")
        self.config = ArmConfig(**fields) if config is None else dataclasses.replace(config, **fields)
        self._session = ArmSession([self.config], isolation)

    def connect(self) -> "YamArm":
        """Bring the arm up, to hold its pose (or to float, with `start="float"`). Return this object.

        Raises:
            YamError: bring-up failed; nothing is energised.
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
        """Clock of the arm's loop: the computer's, or that of a rig in lock-step."""
        return self._session.clock

    @property
    def _client(self) -> ArmClient:
        return self._session[self.config.name]

    def info(self) -> ArmInfo:
        """Describe the arm and its settings. Raises LifeCycleError: the arm is not connected."""
        return ArmInfo.of(self._client)

    def observe(self) -> ArmState:
        """Read the newest state. Raises StaleStateError, MotorError, LifeCycleError: see `ArmClient.observe`."""
        return self._client.observe()

    @contextmanager
    def recording(self, path: str | Path | None = None) -> Iterator[StateRecorder]:
        """Record every state into a `StateRecorder` while the block runs.

        Args:
            path: .npz file to write at the end, see `StateRecorder.save`; None: write none.

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
        """Write one target; repeat it at 10 Hz or faster, or the arm comes to rest.

        Args:
            q: (n,) target of the joints, rad. kp, kd: (n,) gains for this target.
            dq: (n,) speed of the target itself, rad/s. Targets that agree with `dq` (to 0.01 rad) are tracked without
                lag, and the last one moves on until the next is due; other targets are reached one period late.
            gripper: target, 0 closed … 1 open; None keeps the present one.

        Returns:
            Target (n,) after the limits, rad.

        Raises:
            ActionError: a value has a wrong shape, is not finite, or is more than a motor takes; nothing was sent.
            YamError: the arm floats, has failed or is silent; nothing was sent.
        """
        return self._client.write_target(q, gripper, dq, kp, kd)[0]

    def move_to(self, q: Vector, gripper: float | None = None, speed_rad_s: float = 0.8) -> ArmState:
        """Move to a pose along a straight joint line with half-cosine speed, and wait until the arm is there.

        Args:
            q: (n,) goal of the joints, rad.
            gripper: goal, 0 closed … 1 open; None keeps the present set-point.
            speed_rad_s: peak speed of the quickest joint.

        Raises:
            ActionError: a value has a wrong shape, is not finite, or is beyond a joint's range; nothing moves.
            LifeCycleError: the pose was not reached (obstructed, stopped, or limits hold the arm back).
        """
        goal = self._goal(q, gripper)
        hw = self._client.hardware
        speed = np.concatenate([np.full(hw.joints, speed_rad_s), hw.speed_limit[hw.joints :]])
        start = ready([self._client])
        goal = np.where(np.isnan(goal), start, goal)
        return self._play(Playback([self._client], soft_way(start, goal, approach_s(goal - start, speed))))

    def move_joints(self, q: Vector, time_s: float, gripper: float | None = None) -> ArmState:
        """Move to a pose in `time_s` seconds along a straight joint line with half-cosine speed, and wait for the end.

        Args:
            q: (n,) goal of the joints, rad.
            time_s: duration of the motion, s.
            gripper: goal, 0 closed … 1 open; None keeps the present set-point.

        Raises:
            ActionError: see `move_to`; or the time is too short for the limits of speed and acceleration, and the
                message has the shortest time. Nothing moves.
            LifeCycleError: see `move_to`.
        """
        name, hw = self.config.name, self._client.hardware
        goal, seconds = self._goal(q, gripper), finite_number(name, "time_s", time_s)
        start = np.array(self._client.observe().setpoints)
        goal = np.where(np.isnan(goal), start, goal)
        acceleration = np.concatenate([np.full(hw.joints, ACCELERATION_LIMIT_RAD_S2), [np.inf] * hw.has_gripper])
        least = max(soft_way_s(goal - start, hw.speed_limit, acceleration), _STREAM_S)
        if seconds < least:
            raise ActionError(
                f"{name}: it takes {least:.2f} s at least, not {seconds:g}: give time_s more; nothing moves"
            )
        return self._play(Playback([self._client], soft_way(ready([self._client]), goal, seconds)))

    def replay(self, trajectory: Trajectory) -> ArmState:
        """Move softly to where the trajectory begins, then along it, and wait until the arm is at its end.

        The arm is slower where the trajectory exceeds the speed limits; `track_integral` brings it closer to the
        trajectory. `load_trajectory` and `save_trajectory` of `session/trajectory_file.py` read and write files.

        Raises:
            ActionError: the trajectory has other joints, or goes beyond a joint's range; nothing moves.
            LifeCycleError: see `move_to`.
        """
        return self._play(replay([self._client], trajectory))

    def _goal(self, q: Vector, gripper: float | None) -> np.ndarray:
        """Check a goal; return it as (n,) motors, NaN for a gripper that stays. Raises ActionError: as `move_to`."""
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
        """Keep the present pose."""
        self._client.hold()

    def float(self) -> None:
        """Carry only the arm's own weight, so that a hand can move it."""
        self._client.float()

    def update_kp_kd(self, kp: Vector, kd: Vector) -> None:
        """Change the gains of the joints, within half a second; the arm lands with the configured gains.

        Args:
            kp, kd: (n,) gains, Nm/rad and Nm s/rad.

        Raises:
            ActionError, ConfigError: a configuration with these gains would be refused; nothing changes.
            LifeCycleError: the arm lands, or is off.
        """
        self._client.change_gains(kp, kd)

    def zero_torque(self, force: bool = False) -> None:
        """Cut torque, without landing. Afterwards only `close` is possible.

        HAZARD: with `force` an arm in the air falls at once, with what it holds.

        Raises:
            LifeCycleError: the arm does not lie at rest, and `force` is not set; or its mode does not allow it.
            YamError: the arm has failed or is silent, so that its pose is unknown, and `force` is not set.
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
        """Enable failed motors again, and hold the measured pose. Look at the arm first.

        Raises:
            LifeCycleError: a motor still fails, or the arm needs a new connection.
        """
        self._session.rearm()

    def land(self) -> None:
        """Land the arm, cut torque, and wait until torque is off. Afterwards only `close` is possible."""
        self._session.land()
