"""Keys that drive a mobile base, as a LeRobot teleoperator, for those without a gamepad."""

import logging
import sys
from collections.abc import Callable

from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.driving.base_drive import BaseDrive
from lerobot_robot_yam.face.driving.held_keys import HELP, HeldKeys
from lerobot_robot_yam.face.operator_keys.typed_keys import listen
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_teleoperator_yam.config_yam_gamepad import YamBaseKeysConfig
from lerobot_teleoperator_yam.drive_teleoperator import DriveTeleoperator

logger = logging.getLogger(__name__)


class YamBaseKeys(DriveTeleoperator):
    """Keys of the terminal in which the command runs. Keys typed into other windows drive nothing."""

    config_class = YamBaseKeysConfig
    name = "yam_base_keys"

    config: YamBaseKeysConfig
    _driver: HeldKeys | None = None
    _end_keys: Callable[[], None] | None = None

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:
        """Energise nothing. Keys count from the first action on. Raises ConfigError: there is no terminal."""
        if not sys.stdin.isatty():
            raise ConfigError(
                f"{self.name}: there is no terminal to type into (standard input is none); start the command in a "
                "terminal, over ssh with `ssh -t`, or use a gamepad"
            )
        stop = EmergencyStop()
        self._driver = HeldKeys(self.config.hold_s, stop)
        self._drive = BaseDrive(self.name, self.config, stop)
        logger.info("%s connected: %s", self, HELP)

    def disconnect(self) -> None:
        """End listening to keys. Idempotent."""
        self._driver = self._drive = None
        end, self._end_keys = self._end_keys, None
        if end is not None:
            end()

    @check_if_not_connected
    def get_action(self) -> dict[str, float]:
        """Return the velocities that the held keys ask for; zeros without a key, see `BaseDrive`."""
        assert self._driver is not None
        if self._end_keys is None:  # LeRobot's own listener is running by now
            self._end_keys = listen(self._driver.typed, terminal=True)
        return super().get_action()
