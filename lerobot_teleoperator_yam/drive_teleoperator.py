"""What the teleoperators that drive only a mobile base have in common."""

from collections.abc import Mapping
from functools import cached_property
from typing import Any

from lerobot.teleoperators.teleoperator import Teleoperator
from lerobot.utils.decorators import check_if_not_connected

from lerobot_robot_yam.face.driving.base_drive import BaseDrive, Driver
from lerobot_robot_yam.face.recorder.kept_episodes import saves_finished_episode
from lerobot_robot_yam.session.uncopyable import Uncopied


class DriveTeleoperator(Uncopied, Teleoperator):
    """Teleoperator whose actions are what a `Driver` asks of a base. A subclass opens the driver in `connect`."""

    _driver: Driver | None = None
    _drive: BaseDrive | None = None

    def __init__(self, config: Any):
        super().__init__(config)
        self.config = config

    @cached_property
    def action_features(self) -> dict[str, type]:
        """Features `x.vel`, `y.vel` (m/s), `theta.vel` (deg/s); with the option `rail`, `height.vel` (m/s)."""
        return dict.fromkeys(self.config.drive_keys(), float)

    @property
    def feedback_features(self) -> dict[str, type]:
        """Empty mapping: feedback cannot move a stick or a key."""
        return {}

    @property
    def is_connected(self) -> bool:
        """Whether `connect` was called and `disconnect` was not. A pad that is unplugged does not count."""
        return self._drive is not None

    @property
    def is_calibrated(self) -> bool:
        """Always True: `connect` refuses a device that needs a calibration."""
        return True

    def calibrate(self) -> None:
        """Do nothing: there is nothing to calibrate."""

    def configure(self) -> None:
        """Do nothing: there is nothing to configure."""

    @check_if_not_connected
    @saves_finished_episode
    def get_action(self) -> dict[str, float]:
        """Return the velocities that the person asks for; zeros in trouble of the device, see `BaseDrive`."""
        assert self._drive is not None and self._driver is not None
        return self._drive.action(self._driver.asked())

    def send_feedback(self, feedback: Mapping[str, Any]) -> None:
        """Do nothing: feedback cannot move a stick or a key."""
