"""The emergency stop of two computers: while it is latched on one it is latched on the other, and released with it.

Each tells the other only of a stop of its own, never of one that it has taken over. So a stop ends where it began:
what came from the other computer, and is released here, is latched again at its next word.
"""

import contextlib
import logging

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.state.emergency_stop import EmergencyStop

logger = logging.getLogger(__name__)


class MirroredStop:
    """This computer's latch, as the other one drives it.

    Args:
        other: what the other computer is called here; reasons of stops that come from it begin with that.
    """

    def __init__(self, other: str):
        self._stop, self._prefix = EmergencyStop(), f"{other}: "

    @property
    def own(self) -> bool:
        """Whether it is latched here, and not because the other computer says so."""
        return self._stop.latched and not self.taken_over

    @property
    def taken_over(self) -> bool:
        """Whether it is latched here because the other computer says so."""
        return self._stop.reason().startswith(self._prefix)

    def follow(self, stopped: bool, why: str) -> None:
        """Latch as the other computer does, or release what was latched because of it."""
        with contextlib.suppress(OSError, ConfigError):  # then this object alone says that it is latched
            if stopped and not self._stop.latched:
                self._stop.latch(self._prefix + why)
            elif not stopped and self._stop.latched and self.taken_over:
                self._stop.release()
                logger.warning("emergency stop released, as on the other computer")
