"""The emergency stop of leaders without motors: they fall when a hand lets go of them to stop the arms.

A leader that lies on the table must not take its follower along once the stop is released. A gate that begins with a
lift or a button takes care of that. All other leaders stay stopped until their triggers are squeezed: then they are in
a hand. A squeeze also keeps what the follower's gripper may hold.
"""

import logging
import math
from collections.abc import Sequence

from lerobot_robot_yam.state.emergency_stop import EmergencyStop

logger = logging.getLogger(__name__)

_RELEASED, _SQUEEZED = 0.3, 0.7


class PassiveStop:
    """Of all leaders of a loop. Ask once per tick.

    Args:
        stop: the latch.
        names: of the leaders that stay stopped until their triggers are squeezed, by number of the leader.
    """

    def __init__(self, stop: EmergencyStop, names: dict[int, str]):
        self._stop, self._names = stop, names
        self._stopped = self._told = False
        self._least: dict[int, float] = {}  # of each trigger since the release

    def check(self, triggers: Sequence[float]) -> bool:
        """Whether the leaders are stopped. triggers: 0 released … 1 squeezed, NaN of a silent one."""
        if self._stop.latched:
            self._stopped, self._told = True, False
            self._least = dict.fromkeys(self._names, math.inf)
        elif self._stopped:
            self._stopped = not self._confirmed(triggers)
        return self._stopped

    def _confirmed(self, triggers: Sequence[float]) -> bool:
        """Whether all triggers are squeezed that have been released since the stop was."""
        if self._names and not self._told:
            which = " and ".join(self._names.values())
            logger.warning("%s: squeeze the trigger, with the leader in your hand, to go on after the stop", which)
            self._told = True
        for index, least in self._least.items():
            self._least[index] = min(least, triggers[index])  # NaN leaves it as it is
        if not all(least < _RELEASED and triggers[index] > _SQUEEZED for index, least in self._least.items()):
            return False
        logger.info("leaders go on after the emergency stop")
        return True
