"""Two leader arms, and a gamepad or a leader's handle that drives the base, as one LeRobot teleoperator."""

from collections.abc import Mapping
from functools import cached_property
from typing import Any

from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected

from lerobot_robot_yam.arm.mounting import resolve_profiles
from lerobot_robot_yam.face.driving.base_drive import Asked, BaseDrive
from lerobot_robot_yam.face.driving.handle_drive import HandleDrive
from lerobot_robot_yam.face.driving.pad_watch import PadWatch
from lerobot_robot_yam.face.driving.rig_drive import RigDrive
from lerobot_robot_yam.face.recorder.kept_episodes import saves_finished_episode
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_teleoperator_yam.config_yam_mobile_leader import YamMobileLeaderConfig
from lerobot_teleoperator_yam.yam_gamepad import watch_pad
from lerobot_teleoperator_yam.yam_leader import LeaderBase


class YamMobileLeader(LeaderBase):
    """Two YAM arms moved by hand, and a driver of the base."""

    config_class = YamMobileLeaderConfig
    name = "yam_mobile_leader"

    def __init__(self, config: YamMobileLeaderConfig):
        super().__init__(config)
        self._driver: PadWatch | RigDrive | None = None
        self._handle: HandleDrive | None = None
        self._prefix = f"{config.drive}_"
        if (driver := config.driver) is not None:
            models = resolve_profiles(driver.arm, driver.gripper)
            self._handle = HandleDrive(f"{config.drive} leader", models, config.drive_button, config.rail)
        self._frozen: dict[str, float] = {}  # the driving leader's part of the action while it drives

    @cached_property
    def action_features(self) -> dict[str, Any]:
        """Features of both arms, then `x.vel`, `y.vel` (m/s), `theta.vel` (deg/s), and with `rail` `height.vel`."""
        return super().action_features | dict.fromkeys(self.config.drive_keys(), float)

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:
        """Open the gamepad, then energise both arms, which float. After an error nothing is open or energised.

        Raises:
            ConfigError, LifeCycleError: there is no usable gamepad, or a stick is off its rest.
            YamError: see `LeaderBase.connect`.
        """
        stop = EmergencyStop()
        self._drive, self._frozen = BaseDrive(self.name, self.config, stop), {}
        if self._handle is not None:
            self._handle.forget()
        elif self.config.drive == "rig":
            self._driver = RigDrive(self.config.left_arm_config.can_options.get("rig"), self.config.speed)
        elif calibrate:
            self._driver = watch_pad(self.name, self.config, self.config.calibration_dir, stop)
        try:
            super().connect(calibrate)
        except BaseException:
            self._close_driver()
            raise

    def disconnect(self) -> None:
        """Land the arms, then release the gamepad. Idempotent."""
        try:
            super().disconnect()
        finally:
            self._close_driver()

    def _close_driver(self) -> None:
        driver, self._driver = self._driver, None
        if driver is not None:
            driver.close()

    @check_if_not_connected
    @saves_finished_episode
    def get_action(self) -> dict[str, float]:
        """Return the action of both arms, see `LeaderBase`, and of the base, see `BaseDrive`.

        While a leader's handle drives, its follower stays. When the button is let go, the follower goes to the leader
        at its own speed limit.

        Raises:
            YamError: an arm has failed, or has no recent data.
        """
        action = super().get_action()
        return action | self._drive.action(self._asked(action)) | self._frozen

    def _asked(self, action: Mapping[str, float]) -> Asked:
        if self._driver is not None:
            return self._driver.asked()
        if self._handle is None:  # connected for a calibration
            return Asked()
        asked = self._handle.asked(self.arm_states()[self._prefix])
        if not self._handle.holds:
            self._frozen = {}
        elif not self._frozen:
            self._frozen = {key: value for key, value in action.items() if key.startswith(self._prefix)}
        return asked

    @check_if_not_connected
    def send_feedback(self, feedback: Mapping[str, Any]) -> None:
        """Move the arms, see `LeaderBase.send_feedback`. The base's part of `feedback` is left out."""
        super().send_feedback({key: value for key, value in feedback.items() if key in self._space.keys})
