"""Keys of a terminal that drive a base while they are held.

A terminal tells presses and repeats, never releases: a key counts as held for a short time after each of them. Only the
key that was pressed last repeats.
"""

import logging
import threading
import time
from collections.abc import Callable

from lerobot_robot_yam.face.driving.base_drive import STOPPED, VALID_S, Asked
from lerobot_robot_yam.face.driving.pad_map import FRAME, RESET
from lerobot_robot_yam.state.emergency_stop import EmergencyStop

logger = logging.getLogger(__name__)

_WAYS = {  # key → number of the direction, and its sign; none has a meaning for LeRobot
    **{"i": (0, 1.0), "k": (0, -1.0), "j": (1, 1.0), "l": (1, -1.0)},
    **{"u": (2, 1.0), "o": (2, -1.0), "t": (3, 1.0), "g": (3, -1.0)},
}
_PRESSES = {"f": FRAME, "z": RESET}
_SLOW, _STOP = "v", "x"
HELP = (
    "hold i/k to drive forward/backward, j/l to the left/right, u/o to turn left/right, t/g for the rail up/down; "
    "v: fast or slow, f: frame, z: reset of the odometry, x: EMERGENCY STOP"
)


class HeldKeys:
    """Keys that are held, see `Driver`. Begins slow, since a key knows no half.

    Args:
        hold_s: time for which a key counts as held after a press or repeat, s.
        stop: the emergency stop.
        clock: time, s.
    """

    def __init__(self, hold_s: float, stop: EmergencyStop, clock: Callable[[], float] = time.monotonic):
        self._hold_s, self._stop, self._clock = hold_s, stop, clock
        self._lock = threading.Lock()
        self._until_s: dict[str, float] = {}
        self._presses: list[tuple[float, str]] = []
        self._slow = True
        self._stopped = False  # whether a key was typed during an emergency stop, since `asked`

    def typed(self, key: str) -> None:
        """Take in a key. Any thread may call this; the emergency stop acts at once."""
        key = key.lower()
        if key == _STOP:
            self._stop.latch("key x of yam_base_keys", "keys")
        with self._lock:
            self._stopped |= self._stop.latched
            if key in _WAYS:
                self._until_s[key] = self._clock() + self._hold_s
            elif key in _PRESSES:
                self._presses.append((self._clock(), _PRESSES[key]))
            elif key == _SLOW:
                self._slow = not self._slow
                logger.info("keys drive %s", "slowly" if self._slow else "fast")

    def asked(self) -> Asked:
        """Return what the held keys ask, and what was pressed since the last call."""
        deflection, now = [0.0, 0.0, 0.0, 0.0], self._clock()
        with self._lock:
            for key, until_s in self._until_s.items():
                if now < until_s:
                    number, sign = _WAYS[key]
                    deflection[number] += sign
            presses, self._presses = [press for at_s, press in self._presses if now - at_s < VALID_S], []
            stopped, self._stopped = self._stopped, False
            if stopped:
                return Asked(trouble=STOPPED)
            x, y, theta, height = deflection
            return Asked((x, y, theta, height), self._slow, presses)
