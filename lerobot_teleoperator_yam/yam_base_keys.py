"""Keys that drive a mobile base, as a LeRobot teleoperator, for those without a gamepad."""

import logging
import sys
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any

from lerobot.teleoperators.teleoperator import Teleoperator
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.driving.base_drive import BaseDrive
from lerobot_robot_yam.face.driving.held_keys import HELP, HeldKeys
from lerobot_robot_yam.face.operator_keys.typed_keys import listen
from lerobot_robot_yam.face.recorder.kept_episodes import saves_finished_episode
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.system.uncopyable import Uncopied
from lerobot_teleoperator_yam.config_yam_gamepad import YamBaseKeysConfig

logger = logging.getLogger(__name__)


class YamBaseKeys(Uncopied, Teleoperator):
    """Keys of the terminal in which the command runs. Keys typed into other windows drive nothing."""

    config_class = YamBaseKeysConfig
    name = "yam_base_keys"

    def __init__(self, config: YamBaseKeysConfig):
        super().__init__(config)
        self.config = config
        self._keys: HeldKeys | None = None
        self._drive: BaseDrive | None = None
        self._end_keys: Callable[[], None] | None = None

    @cached_property
    def action_features(self) -> dict[str, type]:
        """Features `x.vel`, `y.vel` (m/s), `theta.vel` (deg/s); with the option `rail`, `height.vel` (m/s)."""
        return dict.fromkeys(self.config.drive_keys(), float)

    @property
    def feedback_features(self) -> dict[str, type]:
        """Empty mapping: feedback cannot move a key."""
        return {}

    @property
    def is_connected(self) -> bool:
        """Whether `connect` was called and `disconnect` was not."""
        return self._drive is not None

    @property
    def is_calibrated(self) -> bool:
        """Always True: there is nothing to calibrate."""
        return True

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:
        """Energise nothing. Keys count from the first action on. Raises ConfigError: there is no terminal."""
        if not sys.stdin.isatty():
            raise ConfigError(
                f"{self.name}: there is no terminal to type into (standard input is none); start the command in a "
                "terminal, over ssh with `ssh -t`, or use a gamepad"
            )
        stop = EmergencyStop()
        self._keys = HeldKeys(self.config.hold_s, stop)
        self._drive = BaseDrive(self.name, self.config, stop)
        logger.info("%s connected: %s", self, HELP)

    def disconnect(self) -> None:
        """End listening to keys. Idempotent."""
        self._drive = None
        end, self._end_keys = self._end_keys, None
        if end is not None:
            end()

    def calibrate(self) -> None:
        """Do nothing: there is nothing to calibrate."""

    def configure(self) -> None:
        """Do nothing: there is nothing to configure."""

    @check_if_not_connected
    @saves_finished_episode
    def get_action(self) -> dict[str, float]:
        """Return the velocities that the held keys ask for; zeros without a key, see `BaseDrive`."""
        assert self._drive is not None and self._keys is not None
        if self._end_keys is None:  # LeRobot's own listener is running by now
            self._end_keys = listen(self._keys.typed, terminal=True)
        return self._drive.action(self._keys.asked())

    def send_feedback(self, feedback: Mapping[str, Any]) -> None:
        """Do nothing: feedback cannot move a key."""
