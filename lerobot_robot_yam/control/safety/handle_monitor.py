"""The teaching handle as an arm's controller sees it: fresh or unknown, and a button that stops everything."""

import logging
import math

from lerobot_robot_yam.damiao.encoder import HandleEncoder

logger = logging.getLogger(__name__)

_SILENT_S = 0.25


class HandleMonitor:
    """Freshness of a teaching handle; a silent one is said once and never reads as zero."""

    def __init__(self, arm: str, encoder: HandleEncoder | None):
        self._arm = arm
        self._encoder = encoder
        self._was_silent = False

    def read(self, now: float) -> tuple[float, tuple[bool, bool], float]:
        """Trigger 0 … 1 (NaN without a handle or while it is silent), buttons, stamp of the newest report."""
        encoder = self._encoder
        if encoder is None:
            return math.nan, (False, False), -math.inf
        silent = now - encoder.stamp_s > _SILENT_S
        if silent and not self._was_silent:
            logger.warning("%s: the teaching handle is silent; its trigger and buttons are unknown", self._arm)
        self._was_silent = silent
        if silent:
            return math.nan, (False, False), encoder.stamp_s
        return encoder.report.trigger, encoder.report.buttons, encoder.stamp_s


class StopButton:
    """A button of the handle that latches the emergency stop when it is pressed.

    Args:
        which: 0 the top one, 1 the other one, None: no button does.
    """

    def __init__(self, which: int | None):
        self._which = which
        self._down = True  # held down at start it means nothing until it has been released

    def pressed(self, buttons: tuple[bool, bool]) -> bool:
        """True on the tick on which it goes down."""
        if self._which is None:
            return False
        before, self._down = self._down, bool(buttons[self._which])
        return self._down and not before
