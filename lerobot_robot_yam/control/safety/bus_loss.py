"""Whether a channel takes an arm's frames, and what has befallen it when it does not."""

import errno
import math

from lerobot_robot_yam.errors import BusError
from lerobot_robot_yam.state.faults import Trouble

_TROUBLE = {
    errno.ENODEV: Trouble.ADAPTER_GONE,
    errno.ENETDOWN: Trouble.LINK_DOWN,
    errno.ENOBUFS: Trouble.BUS_OFF,
}
_FULL_S = 0.05  # a transmit queue that takes nothing for so long is not emptied; a late tick's is, soon


class BusLoss:
    """A channel's loss. `lost`: nothing reaches the motors."""

    def __init__(self) -> None:
        self.lost = False
        self._full_since_s = math.inf

    def clear(self) -> None:
        """The channel has taken a whole tick."""
        self.lost, self._full_since_s = False, math.inf

    def note(self, error: BusError, now: float) -> Trouble | None:
        """It has not. Returns what has befallen it, once, as soon as that is certain."""
        trouble = _TROUBLE.get(error.errno or 0, Trouble.ADAPTER_GONE)
        if trouble is Trouble.BUS_OFF:
            self._full_since_s = min(self._full_since_s, now)
            if now - self._full_since_s < _FULL_S:
                return None
        before, self.lost = self.lost, True
        return None if before else trouble
