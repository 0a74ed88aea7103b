"""The emergency stop of two computers: while it is latched on one it is latched on the other, and released with it.

Each tells the other only of a stop of its own, never of one that it has taken over. So a stop ends where it began:
what came from the other computer, and is released here, is latched again at its next word.
"""

import logging

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.state.emergency_stop import EmergencyStop

logger = logging.getLogger(__name__)


class MirroredStop:
    """This computer's latch, as the other one drives it.

    Args:
        other: what the other computer is called here; reasons of stops that come from it begin with that.

    Attributes:
        unwritten: the other computer's stop cannot be latched here.
    """

    def __init__(self, other: str):
        self._stop, self._other, self._prefix = EmergencyStop(), other, f"{other}: "
        self._failed = False
        self.unwritten = False

    @property
    def own(self) -> bool:
        """Whether it is latched here, and not because the other computer says so."""
        return self._stop.latched and not self.taken_over

    @property
    def taken_over(self) -> bool:
        """Whether it is latched here because the other computer says so."""
        return self._stop.reason().startswith(self._prefix)

    def follow(self, stopped: bool, why: str) -> None:
        """Latch as the other computer does, or release what was latched because of it.

        To be called again and again: what fails is tried again by the next call.
        """
        try:
            if stopped and not self._stop.latched:
                EmergencyStop().latch(self._prefix + why)  # an object that has failed to latch never tries again
            elif not stopped and self._stop.latched and self.taken_over:
                self._stop.release()
                logger.warning("emergency stop released, as on the other computer")
        except (OSError, ConfigError) as error:
            self.unwritten = stopped
            if not self._failed:
                logger.error(
                    "%s: its emergency stop cannot be %s here, and is tried again: %s; can %s be written to?",
                    self._other,
                    "latched" if stopped else "released",
                    error,
                    self._stop.directory,
                )
            self._failed = True
        else:
            self.unwritten = self._failed = False
