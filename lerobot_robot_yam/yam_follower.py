"""Follower arms on this or another computer as a LeRobot robot. In data sets both have the same names."""

import logging
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected

from lerobot_robot_yam.config_yam_follower import (
    BiYamFollowerConfig,
    BiYamRemoteConfig,
    YamFollowerConfig,
    YamRemoteConfig,
)
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.face.datasets.recording import recorded_name
from lerobot_robot_yam.face.devices.arm_device import ArmDevice
from lerobot_robot_yam.face.devices.hand_guidance import HandGuidance, guidance
from lerobot_robot_yam.face.devices.recorded_robot import RecordedRobot
from lerobot_robot_yam.face.devices.remote_device import RemoteDevice
from lerobot_robot_yam.face.recorder.kept_episodes import saves_finished_episode
from lerobot_robot_yam.face.recorder.rehearsal import rehearse
from lerobot_robot_yam.face.rl_stack import MotorBus
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.robot_options import FollowerOptions
from lerobot_robot_yam.state.arm_state import ArmState
from lerobot_robot_yam.system.clock import Clock

logger = logging.getLogger(__name__)

_CAUGHT_UP_RAD = 0.15  # distance at which arms have caught up with leaders, rad: the usual lag behind a moving leader
_CATCH_UP_S = 3.0  # extra time for catching up, s, in addition to the travel time at the speed limit
_CATCH_UP_TICK_S = 0.02  # period of sending targets while the arms catch up, s
_SAME = 1e-6  # maximum difference of equal targets, rad or strokes: shared memory rounds them


class FollowerBase(ArmDevice, RecordedRobot):
    """Robot with one or two follower arms.

    Args:
        config: `YamFollowerConfig` or `BiYamFollowerConfig`.
    """

    def __init__(self, config: Any):
        super().__init__(config)
        self.config = config
        options: FollowerOptions = config
        arms = options.arms()
        # With end-effector poses the option is ignored: such data sets do not state the unit of joint velocities.
        self._use_degrees = options.use_degrees and options.action_space == "joint"
        self.name = recorded_name(self.name, options.use_degrees, options.action_space)
        self.robot_type = self.name
        base = self._base_config()
        self._arms = self._make_arms("follower", arms, self._use_degrees, options.runs(), base=base)
        self._speak(options.action_space, [(side.hardware.arm, side.hardware.gripper) for side in self._arms.sides])
        self._make_cameras(config.all_cameras(), [*arms.values(), *([] if base is None else [base])])
        self._last_action: dict[str, Any] = {}
        self._extra_keys = options.optional_keys(self._arms.motors)
        self.bus = MotorBus(self._arms, self.send_action)  # for LeRobot's RL stack
        self._guidance: HandGuidance | None = None

    @cached_property
    def observation_features(self) -> dict[str, type | tuple[int, int, int]]:
        """Types or shapes by key: positions of all arms, in canonical order; optional values; images."""
        keys = [*self._space.keys, *self._extra_keys]
        return {**dict.fromkeys(keys, float), **self._image_features()}

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:
        """Open the cameras and energise the arms, which then hold their pose. An error undoes all steps.

        Under a LeRobot command with connected leaders, the arms then move to the leaders' pose, so that a recording
        does not begin with this approach.

        Args:
            calibrate: search the grippers' stops if they are unknown. False: do not search, and ignore stored stops
                that are implausible; without stops, `calibrate` is the only call allowed next.

        Raises:
            YamError: an arm cannot be driven.
            Exception: a camera cannot be opened; the type depends on the camera.
        """
        self._guidance = guidance()
        if self._guidance is not None:
            self._guidance.attach(self.name, self._arms, self._space, list(self.action_features))
        with self._open():
            self._arms.start(calibrate, list(self.action_features), self._models)
            self._space.begin()
        logger.info("%s connected", self)
        try:
            self._check_started(calibrate)
            self._catch_up()
            self._rehearse()
        except BaseException:
            self.disconnect()
            raise

    def _base_config(self) -> BaseConfig | None:
        """Return the config of the base on which the arms ride, if any."""
        return None

    def _check_started(self, calibrate: bool) -> None:
        """Check what only energised parts can tell. calibrate: as for `connect`."""

    def _catch_up(self) -> None:
        """Move to the leaders' pose, if there are leaders. The first observation reports a failed arm."""
        leaders = self._arms.leader()
        if leaders is None or leaders.give_action is None:
            return
        begin_s, within_s = self.clock.now(), 0.0
        while True:
            try:
                sent = self._write_targets(self._space.vector(self._of_arms(leaders.give_action())))
                gap = np.abs(sent - _measured(self._arms.observe()))[self._arms.is_joint].max(initial=0.0)
            except YamError as error:
                logger.info("%s: does not wait until it is where its leaders are: %s", self, error)
                return
            if gap < _CAUGHT_UP_RAD:
                return
            if not within_s:
                logger.info("%s: goes to the leaders, up to %.1f rad away", self, gap)
                limits = [side.hardware.speed_limit[: side.joints] for side in self._arms.sides]
                within_s = _CATCH_UP_S + gap / np.concatenate(limits).min()
            if self.clock.now() - begin_s > within_s:
                logger.warning("%s: is still %.1f rad from its leaders; look for what is in its way", self, gap)
                return
            self.clock.sleep(_CATCH_UP_TICK_S)

    def _of_arms(self, action: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return the arms' part of an action."""
        return action

    def _rehearse(self) -> None:
        """Observe and follow the leaders once as a recording does. Errors are only logged: a recording repeats them."""

        def step() -> dict[str, Any]:
            self._arms.observe()
            leaders = self._arms.leader()
            if leaders is not None and leaders.give_action is not None:
                self._write_targets(self._space.vector(self._of_arms(leaders.give_action())))
            return self._images.read()[0]

        try:
            rehearse(step)
        except Exception as error:
            logger.info("%s: begins without a rehearsal: %s", self, error)

    @property
    def clock(self) -> Clock:
        """Clock of the arms: the computer's, or that of a lock-step rig."""
        return self._arms.clock

    def discard(self) -> None:
        """End the session without landing, in a lock-step world that is discarded. Idempotent."""
        if self._guidance is not None:
            self._guidance.detach(self._arms)
        self._arms.discard()
        self._close()

    def disconnect(self) -> None:
        """Land the arms, then close the cameras. Idempotent. A camera error cannot prevent the landing."""
        try:
            if self._guidance is not None:
                self._guidance.detach(self._arms)
            self._arms.stop()
        finally:
            self._close()

    @check_if_not_connected
    @saves_finished_episode
    def get_observation(self) -> dict[str, Any]:
        """Return measured positions and the newest images; wait for a late image, see `images`.

        Raises:
            MotorError: a motor has failed.
            StaleStateError: an arm or a camera has no fresh data; the arms hold.
        """
        states = self._arms.observe()
        images, waited = self._images.read()
        if waited:
            states = self._arms.observe()  # the arms have moved during the wait
        observation: dict[str, Any] = dict(self._space.action(_measured(states)))
        if self._extra_keys:
            observation.update(zip(self._extra_keys, self._extras(states), strict=True))
        observation.update(images)
        self._episodes.observed(states, images)
        self._desk.observed()
        return observation

    def _extras(self, states: list[ArmState]) -> list[float]:
        options: FollowerOptions = self.config
        parts: list[np.ndarray] = []
        if options.observe_velocity:
            rates = [_with_gripper(state.dq, state.gripper_rate) for state in states]
            parts.append(np.concatenate(rates) * self._arms.scale)
        if options.observe_torque:
            parts += [_with_gripper(state.tau_nm, state.gripper_tau_nm) for state in states]
        if options.observe_temperature:
            parts += [state.temp_mos_c for state in states] + [state.temp_rotor_c for state in states]
        return np.concatenate(parts).tolist()

    @check_if_not_connected
    @saves_finished_episode
    def send_action(self, action: Mapping[str, Any]) -> dict[str, float]:
        """Send targets to the arms, which move there within their speed limits.

        Args:
            action: a number (or 0-d tensor) for every key of `action_features`, and no other keys.

        Returns:
            The targets actually sent, limited by the arms' reach, joint limits and max_relative_target; while LeRobot
            pauses and repeats its last action, the held targets.

        Raises:
            ActionError: keys or values are wrong; nothing was sent to any arm.
        """
        if self._arms.paused and self._is_last(action):
            return self._space.action(self._arms.held())
        self._arms.paused = False
        guided = None if self._guidance is None else self._guidance.take(action)
        if guided is not None:
            self._episodes.sent(changed=False)
            return self._space.action(guided)
        coupling = self._arms.couple(action, self._space.vector)
        if coupling is None:
            target = self._space.vector(action)
            sent = self._write_targets(target)
        else:
            target, leaders = coupling
            self._space.begin()  # the leader moves the arms: the next inverse kinematics starts a new path
            sent = self._write_targets(target, leaders)
        self._episodes.sent(changed=not np.allclose(sent, target, rtol=0.0, atol=_SAME))
        self._last_action = dict(action)
        return self._space.action(sent)

    def _is_last(self, action: Mapping[str, Any]) -> bool:
        """Return whether `action` repeats the last action. Compares actions, since IK results are not repeatable."""
        last = self._last_action
        return last.keys() == action.keys() and all(np.array_equal(action[key], last[key]) for key in last)

    @check_if_not_connected
    def send_joints(self, target: np.ndarray) -> np.ndarray:
        """Send a target (n,) in canonical order, rad, grippers 0 … 1, regardless of the unit of actions.

        Returns:
            The target actually sent, (n,).

        Raises:
            ActionError: the target is not finite; nothing was sent to the arm concerned.
        """
        self._space.begin()
        return self._write_targets(target)

    def _write_targets(self, target: np.ndarray, leaders: Sequence[str | None] | None = None) -> np.ndarray:
        """Write a target (n,) to the arms. leaders: per arm, channel key of the leader that produced it, or None."""
        sent = target.copy()
        for side, leader in zip(self._arms.sides, leaders or [None] * len(self._arms.sides), strict=True):
            index = side.gripper_index
            gripper = None if index is None else target[index]
            key, take_over = (leader, (0, 0)) if leader else self._arms.leader_at_hand(side)
            sent[side.slice], gripper = self._arms[side].write_target(
                target[side.slice], gripper, leader=key, take_over=take_over
            )
            if index is not None:
                sent[index] = gripper
        return sent

    def action_for(self, joints: np.ndarray) -> dict[str, float]:
        """Convert a target in joint coordinates (n,), as for `send_joints`, to an action."""
        return self._space.action(joints)

    @check_if_not_connected
    def joints(self) -> np.ndarray:
        """Measure joints and grippers, (n,) in canonical order, rad and 0 … 1.

        Raises:
            YamError: an arm does not reply or has failed.
        """
        return _measured(self._arms.observe())


def _with_gripper(joints: np.ndarray, gripper: float | None) -> np.ndarray:
    return joints if gripper is None else np.append(joints, gripper)


def _measured(states: list[ArmState]) -> np.ndarray:
    return np.array([value for state in states for value in state.positions])


class YamFollower(FollowerBase):
    """One YAM arm that follows actions from LeRobot."""

    config_class = YamFollowerConfig
    name = "yam_follower"


class BiYamFollower(FollowerBase):
    """Two YAM arms that follow actions from LeRobot; one control loop drives both in the same tick."""

    config_class = BiYamFollowerConfig
    name = "bi_yam_follower"


class YamRemote(RemoteDevice, YamFollower):
    """One YAM arm driven by another computer."""

    config_class = YamRemoteConfig


class BiYamRemote(RemoteDevice, BiYamFollower):
    """Two YAM arms driven by another computer."""

    config_class = BiYamRemoteConfig


I2rtYamFollower, BiI2rtYamFollower = YamFollower, BiYamFollower  # LeRobot looks up spare types by these names
