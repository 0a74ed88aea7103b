"""Leaders without motors as a LeRobot teleoperator: encoders at every joint, moved by hand."""

import logging
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from lerobot.utils.decorators import check_if_not_connected

from lerobot_robot_yam.arm.config import ArmConfig, LeadArmConfig, passive_of
from lerobot_robot_yam.control.preflight.open_bus import open_bus
from lerobot_robot_yam.control.teleop.passive_mapping import PassiveCalibration
from lerobot_robot_yam.damiao.bus_port import BusPort
from lerobot_robot_yam.damiao.passive_encoders import PassiveEncoders
from lerobot_robot_yam.errors import ConfigError, LifeCycleError
from lerobot_robot_yam.face.devices.arm_group import ArmGroup
from lerobot_robot_yam.face.recorder.kept_episodes import saves_finished_episode
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.session.arm_session import Isolation
from lerobot_robot_yam.state.modes import Mode
from lerobot_teleoperator_yam.config_yam_passive_leader import BiYamPassiveLeaderConfig, YamPassiveLeaderConfig
from lerobot_teleoperator_yam.yam_leader import LeaderBase

logger = logging.getLogger(__name__)

HOME_S, MOVE_S = 3.0, 20.0  # durations of a calibration's steps, s: HOME_S at home, MOVE_S for moving all joints
_STILL_RAD = 0.02
_LOOK_S = 0.1


class PassiveLeaderBase(LeaderBase):
    """Teleoperator with one or two leaders without motors, which cannot float, be moved by feedback, or hold.

    Args:
        config: `YamPassiveLeaderConfig` or `BiYamPassiveLeaderConfig`.
    """

    _stopped: bool  # whether the leaders were stopped at the last action

    def _make_arms(
        self,
        role: str,
        arms: Mapping[str, Any],
        use_degrees: bool,
        isolation: Isolation,
        handles: Collection[str] | None = None,
        base: BaseConfig | None = None,
    ) -> ArmGroup:
        for prefix, arm in arms.items():
            if arm.passive_calibration_path is None:  # default: in a subdirectory, whose files LeRobot never reads
                ident = f"{prefix}{self.id}" if self.id else arm.channel
                arm.passive_calibration_path = str(self.calibration_dir / "yam" / f"{ident}_passive.json")
        return super()._make_arms(role, arms, use_degrees, isolation, handles, base)

    @property
    def feedback_features(self) -> dict[str, type]:
        """Empty mapping: there are no motors for feedback, so a take-over begins with the follower's approach."""
        return {}

    @property
    def is_calibrated(self) -> bool:
        """Whether zeros and ranges are stored. Without stored zeros the encoders' own zeros are used."""
        return all(Path(arm.passive_calibration_path).is_file() for arm in self.config.arms().values())

    def _no_motors(self, *_: Any) -> NoReturn:
        """Raise LifeCycleError: there are no motors."""
        raise LifeCycleError(f"{self}: a passive leader has no motors; it can be neither led nor held")

    send_feedback = enable_torque = disable_torque = rearm = _no_motors

    @check_if_not_connected
    @saves_finished_episode
    def get_action(self) -> dict[str, float]:
        """Return the action as a leader with motors does. While the leaders are stopped, the followers hold.

        The leaders stay stopped after an emergency stop, see `PassiveStop`: a leader may have fallen in the meantime.

        Raises:
            LifeCycleError: the leaders are stopped before the first action.
            MotorError, StaleStateError: see `LeaderBase.get_action`.
        """
        before = self._stopped
        self._stopped = any(state.mode is Mode.STOPPED for state in self._arms.observe())
        if self._stopped and self._action is None:
            raise LifeCycleError(f"{self}: the emergency stop came before its first action; squeeze the trigger first")
        if self._stopped and not before:
            self._arms.pause_followers()
        elif before and not self._stopped:
            self._arms.resume_followers()
        return super().get_action()

    def _restart(self) -> None:
        super()._restart()
        self._stopped = False

    @check_if_not_connected
    def calibrate(self) -> None:
        """Measure zeros and ranges, store them, and use them from now on.

        For the first 3 s all leaders must stay at `home_rad` with the trigger released. During the next 20 s a person
        moves each joint through its range and squeezes the trigger.

        Raises:
            ConfigError: a leader was not at rest at home, or a joint was not moved; nothing was stored.
            YamError: the encoders of a leader are silent.
        """
        arms = [self._arms[side].config for side in self._arms.sides]
        self._arms.stop()  # frees the channels
        for config in arms:
            self._calibrate_one(config)
        self._arms.start(False, self._space.keys, self._models, self.get_action, self._recognise)

    def _calibrate_one(self, config: ArmConfig) -> None:
        assert isinstance(config, LeadArmConfig)
        passive = passive_of(config)
        assert passive is not None and passive.calibration_path is not None
        sign = np.array([*passive.joint_sign, 1], dtype=float)
        with open_bus(config) as bus:
            encoders, port = PassiveEncoders(len(sign) - 1), BusPort(bus, config.channel)
            encoders.start(port, config.name)
            logger.info("%s: leave it at home, trigger released, for %.0f s", config.name, HOME_S)
            low, high = _extremes(port, encoders, sign, HOME_S)
            if (high - low)[:-1].max() > _STILL_RAD:
                joint = int((high - low)[:-1].argmax()) + 1
                raise ConfigError(f"{config.name}: joint_{joint} moved while it should lie at home; calibrate again")
            home = np.zeros(encoders.joints) if passive.home_rad is None else np.array(passive.home_rad)
            # encoder angle at joint angle 0; the mean of low and high is the angle at home
            zero = 0.5 * (low + high) - np.append(home, 0.0)
            logger.info("%s: move each joint through its range, squeeze the trigger: %.0f s", config.name, MOVE_S)
            low, high = _extremes(port, encoders, sign, MOVE_S)
        trigger = float(max(abs(low[-1]), abs(high[-1])))
        ranges = np.stack([low - zero, high - zero], axis=1)[:-1].round(5).tolist()
        found = PassiveCalibration(zero[:-1].round(5).tolist(), ranges, trigger)
        path = Path(passive.calibration_path)
        found.check(config.name)
        found.save(config.name, path)
        logger.info("%s: zeros and ranges stored in %s", config.name, path)


def _extremes(
    port: BusPort, encoders: PassiveEncoders, sign: np.ndarray, seconds: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return minimum and maximum angle of each joint and of the trigger, (n + 1,) rad each, within `seconds`."""
    until_s = port.clock.now() + seconds
    low, high = np.full(len(sign), np.inf), np.full(len(sign), -np.inf)
    while (now := port.clock.now()) < until_s:
        encoders.collect(port, min(now + _LOOK_S * 0.1, until_s))
        angle = sign * encoders.angle_rad
        low, high = np.minimum(low, angle), np.maximum(high, angle)
    return low, high


class YamPassiveLeader(PassiveLeaderBase):
    """One leader without motors."""

    config_class = YamPassiveLeaderConfig
    name = "yam_passive_leader"


class BiYamPassiveLeader(PassiveLeaderBase):
    """Two leaders without motors."""

    config_class = BiYamPassiveLeaderConfig
    name = "bi_yam_passive_leader"
