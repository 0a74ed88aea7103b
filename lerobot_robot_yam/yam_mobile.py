"""A mobile base, alone or with two arms, as a LeRobot robot."""

import logging
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected

from lerobot_robot_yam.config_yam_mobile import (
    YamBaseRemoteConfig,
    YamBaseRobotConfig,
    YamMobileConfig,
    YamMobileRemoteConfig,
)
from lerobot_robot_yam.face.devices.base_part import BasePart, completed
from lerobot_robot_yam.face.devices.device_session import DeviceSession
from lerobot_robot_yam.face.devices.recorded_robot import RecordedRobot
from lerobot_robot_yam.face.devices.remote_device import RemoteDevice
from lerobot_robot_yam.face.devices.replayed_path import replayed_path
from lerobot_robot_yam.face.recorder.kept_episodes import saves_finished_episode
from lerobot_robot_yam.mobile.base_config import BaseConfig, with_rail_file
from lerobot_robot_yam.session.target_limits import validate_action
from lerobot_robot_yam.system.clock import Clock
from lerobot_robot_yam.yam_follower import FollowerBase

logger = logging.getLogger(__name__)


class YamBaseRobot(RecordedRobot):
    """A mobile base that follows actions from LeRobot.

    Args:
        config: the base.
    """

    config_class = YamBaseRobotConfig
    name = "yam_base"

    def __init__(self, config: Any):
        super().__init__(config)
        self.config = config
        base = with_rail_file(config.base(), self.calibration_dir, self.id)
        self._session = DeviceSession(self.name, [base], config.runs())
        self._base = BasePart(self._session, base, config.base_keys(), config.base_extra_keys())
        self._make_cameras(config.all_cameras(), [base])

    @cached_property
    def action_features(self) -> dict[str, type]:
        """Features `x.vel`, `y.vel`, `theta.vel`; with a rail `height.vel` or `height.pos`."""
        return dict.fromkeys(self._base.keys, float)

    @cached_property
    def observation_features(self) -> dict[str, type | tuple[int, int, int]]:
        """Types or shapes by key: velocity, optional values, images."""
        keys = [*self._base.keys, *self._base.extra_keys]
        return {**dict.fromkeys(keys, float), **self._image_features()}

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:
        """Open the cameras and energise the base, which stays where it is. An error undoes all steps.

        Args:
            calibrate: refuse a rail that is not homed. False: for a following `calibrate`.

        Raises:
            YamError: the base cannot be driven.
            Exception: a camera cannot be opened; the type depends on the camera.
        """
        self._base.begin(replayed_path() if self.config.replay_poses else None)
        with self._open():
            self._session.energise()
        logger.info("%s connected", self)
        try:
            if calibrate:
                self._base.check_homed()
        except BaseException:
            self.disconnect()
            raise

    @property
    def is_connected(self) -> bool:
        """Whether the base is connected. Cameras do not count: a dead camera must not prevent braking."""
        return self._session.connected

    @property
    def is_calibrated(self) -> bool:
        """Whether the rail's height is known, see `BasePart.calibrated`."""
        return self._base.calibrated

    @check_if_not_connected
    def calibrate(self) -> None:
        """Home the rail: it goes all the way up and down. Raises YamError: homing failed; the brake holds."""
        self._base.calibrate()

    def configure(self) -> None:
        """Do nothing: the control loop has checked and set up the motors."""

    @property
    def clock(self) -> Clock:
        """Clock of the base: the computer's, or that of a lock-step rig."""
        return self._session.clock

    @check_if_not_connected
    def rearm(self) -> None:
        """Enable failed motors again. Raises YamError: a motor still fails."""
        self._session.rearm()

    @check_if_not_connected
    @saves_finished_episode
    def get_observation(self) -> dict[str, Any]:
        """Return the measured velocity, optional values, and the newest images; wait for a late image.

        Raises:
            MotorError: a motor has failed.
            StaleStateError: the base or a camera has no fresh data; the base brakes.
        """
        images, _ = self._images.read()
        observation: dict[str, Any] = {**self._base.observe(), **images}
        self._episodes.observed([], images)
        self._desk.observed()
        return observation

    @check_if_not_connected
    @saves_finished_episode
    def send_action(self, action: Mapping[str, Any]) -> dict[str, float]:
        """Send a velocity, which the base plans its way to. Without another action it brakes after 0.25 s.

        Args:
            action: a number (or 0-d tensor) for every key of `action_features`, and no other keys.

        Returns:
            The velocity actually sent: a faster one is slowed down in its direction.

        Raises:
            ActionError: keys or values are wrong; nothing was sent.
            YamError: the base has failed or is silent; nothing was sent.
        """
        action = completed(action, self.action_features, self.observation_features)
        validate_action(self.name, action, self._base.keys)
        return self._base.send(self._base.target(action))

    def disconnect(self) -> None:
        """Brake and cut torque, then close the cameras. Idempotent. A camera's error cannot prevent the braking."""
        try:
            self._session.stop()
        finally:
            self._close()


class YamMobile(FollowerBase):
    """A mobile base with two YAM arms that follow actions from LeRobot; one control loop drives all of it."""

    config_class = YamMobileConfig
    name = "yam_mobile"

    def __init__(self, config: YamMobileConfig):
        super().__init__(config)
        assert self._arms.base_config is not None
        self._base = BasePart(self._arms, self._arms.base_config, config.base_keys(), config.base_extra_keys())
        # `BasePart.target` of the last action before a pause
        self._driven: np.ndarray = np.zeros(len(self._base.keys))

    def _base_config(self) -> BaseConfig:
        return with_rail_file(self.config.base(), self.calibration_dir, self.id)

    def _check_started(self, calibrate: bool) -> None:
        if calibrate:
            self._base.check_homed()

    @property
    def is_calibrated(self) -> bool:
        """Whether the stops of all grippers and the rail's height are known."""
        return super().is_calibrated and self._base.calibrated

    @check_if_not_connected
    def calibrate(self) -> None:
        """Search for the grippers' stops, then home the rail: it goes all the way up and down.

        Raises:
            YamError: a search or homing failed.
        """
        super().calibrate()
        self._base.calibrate()

    @cached_property
    def action_features(self) -> dict[str, type]:
        """Features of the arms, as of `bi_yam_follower`, then those of the base, as of `yam_base`."""
        return dict.fromkeys([*self._space.keys, *self._base.keys], float)

    @cached_property
    def observation_features(self) -> dict[str, type | tuple[int, int, int]]:
        """Types or shapes by key: what actions have, then optional values of the arms and of the base, then images."""
        keys = [*self.action_features, *self._extra_keys, *self._base.extra_keys]
        return {**dict.fromkeys(keys, float), **self._image_features()}

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:
        """Open the cameras, energise base and arms, and go to the leaders' pose; see `YamFollower.connect`."""
        self._base.begin(replayed_path() if self.config.replay_poses else None)
        super().connect(calibrate)

    def _of_arms(self, action: Mapping[str, Any]) -> dict[str, Any]:
        return {key: action[key] for key in self._space.keys if key in action}

    @check_if_not_connected
    @saves_finished_episode
    def get_observation(self) -> dict[str, Any]:
        """Return measured positions of the arms, velocity of the base, optional values, and the newest images.

        Raises:
            MotorError: a motor has failed.
            StaleStateError: a part or a camera has no fresh data; the arms hold, and the base brakes.
        """
        return {**super().get_observation(), **self._base.observe()}

    @check_if_not_connected
    @saves_finished_episode
    def send_action(self, action: Mapping[str, Any]) -> dict[str, float]:
        """Send targets to the arms and a velocity to the base. Nothing is sent before all of it is checked.

        An action that has all `.pos` of an observation and nothing else, with which lerobot-rollout returns to its
        start, moves the arms; the base stands.

        Args:
            action: a number (or 0-d tensor) for every key of `action_features`, and no other keys.

        Returns:
            The action actually sent, see `YamFollower.send_action` and `YamBaseRobot.send_action`.

        Raises:
            ActionError: keys or values are wrong; nothing was sent to any part.
            YamError: a part has failed or is silent; nothing was sent to the base.
        """
        action = completed(action, self.action_features, self.observation_features)
        validate_action(self.name, action, list(self.action_features))
        driven = self._base.target(action)
        sent = super().send_action(self._of_arms(action))
        if not self._arms.paused:
            self._driven = driven
        repeats = self._arms.paused and np.array_equal(driven, self._driven)
        return {**sent, **self._base.send(driven, repeats)}


class YamBaseRemote(RemoteDevice, YamBaseRobot):
    """A mobile base driven by another computer."""

    config_class = YamBaseRemoteConfig


class YamMobileRemote(RemoteDevice, YamMobile):
    """A mobile base with two arms, driven by another computer."""

    config_class = YamMobileRemoteConfig
