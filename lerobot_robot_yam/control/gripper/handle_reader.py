"""Reader of a teaching handle: trigger scaled to its calibrated range, debounced buttons, silence detection."""

import logging
import math
from typing import NamedTuple

from lerobot_robot_yam.control.gripper.trigger_range import TriggerRange
from lerobot_robot_yam.damiao.handle_encoder import HandleEncoder

logger = logging.getLogger(__name__)

_SILENT_S = 0.25
_BOUNCE_S = 0.01  # debounce time of the buttons, s: switches bounce for some milliseconds


class HandleState(NamedTuple):
    """Trigger 0 released … 1 squeezed, NaN while the handle is silent; buttons; timestamp of the newest report, s."""

    trigger: float
    buttons: tuple[bool, bool]
    stamp_s: float


NO_HANDLE = HandleState(math.nan, (False, False), -math.inf)


class HandleReader:
    """Reader of one handle. Read once per tick.

    Args:
        arm: name of the arm, for messages.
        encoder: decoder of the handle's reports.
        travel: the trigger's calibrated range.
    """

    def __init__(self, arm: str, encoder: HandleEncoder, travel: TriggerRange):
        self._arm, self._encoder, self._travel = arm, encoder, travel
        self._silent = False
        self._buttons = [False, False]
        self._since_s = [math.inf, math.inf]  # time since which each button is reported as changed
        self._held = [True, True]  # whether held since the handle was silent; ignored until released

    @property
    def raw_buttons(self) -> tuple[bool, bool]:
        """Buttons of the newest report, not debounced, so that an emergency stop acts at once."""
        return (False, False) if self._silent else self._encoder.report.buttons

    def read(self, now: float) -> HandleState:
        """Return the handle's state at this tick. A silent handle is logged once; its trigger reads as NaN, not 0."""
        encoder = self._encoder
        before, self._silent = self._silent, now - encoder.stamp_s > _SILENT_S
        if self._silent:
            if not before:
                logger.warning("%s: the teaching handle is silent; its trigger and buttons are unknown", self._arm)
            self._buttons, self._since_s, self._held = [False, False], [math.inf, math.inf], [True, True]
            return HandleState(math.nan, (False, False), encoder.stamp_s)
        if before and encoder.stamp_s > -math.inf:
            logger.info("%s: the teaching handle answers again", self._arm)
        for index, down in enumerate(encoder.report.buttons):
            if self._held[index]:
                self._held[index] = down
            elif down is self._buttons[index]:
                self._since_s[index] = math.inf
            else:
                self._since_s[index] = min(self._since_s[index], encoder.stamp_s)
                if encoder.stamp_s - self._since_s[index] >= _BOUNCE_S:
                    self._buttons[index], self._since_s[index] = down, math.inf
        buttons = self._buttons[0], self._buttons[1]
        return HandleState(self._travel.share(encoder.report.trigger), buttons, encoder.stamp_s)
