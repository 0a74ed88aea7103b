"""Reader of a teaching handle: trigger scaled to its calibrated range, debounced buttons, silence detection."""

import logging
import math
from typing import NamedTuple

from lerobot_robot_yam.control.gripper.trigger_range import TriggerRange
from lerobot_robot_yam.damiao.handle_encoder import HandleEncoder

logger = logging.getLogger(__name__)

_SILENT_S = 0.25
_BOUNCE_S = 0.01  # time for which a button has to be up before it is released, s: switches bounce for some milliseconds


class HandleState(NamedTuple):
    """Trigger 0 released … 1 squeezed, NaN while the handle is silent; whether each button is down; timestamp of the
    newest report, s; presses of each button since the start.
    """

    trigger: float
    buttons: tuple[bool, bool]
    stamp_s: float
    presses: tuple[int, int] = (0, 0)


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
        self._down = [True, True]  # whether down, or not known to be up: no press is missed, and none is invented
        self._held = [True, True]  # whether down since the handle was silent, which is no press
        self._up_since_s = [math.inf, math.inf]
        self._presses = [0, 0]

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
            self._down, self._held, self._up_since_s = [True, True], [True, True], [math.inf, math.inf]
            return HandleState(math.nan, (False, False), encoder.stamp_s, self._counted)
        if before and encoder.stamp_s > -math.inf:
            logger.info("%s: the teaching handle answers again", self._arm)
        for index, down in enumerate(encoder.report.buttons):
            self._note(index, down, encoder.stamp_s)
        buttons = [down and not held for down, held in zip(self._down, self._held, strict=True)]
        trigger = self._travel.share(encoder.report.trigger)
        return HandleState(trigger, (buttons[0], buttons[1]), encoder.stamp_s, self._counted)

    def _note(self, index: int, down: bool, stamp_s: float) -> None:
        """Process one button of a report. The first report of a press counts, so that a short tap is heard."""
        if down:
            self._up_since_s[index] = math.inf
            if not self._down[index]:
                self._down[index] = True
                self._presses[index] += 1
            return
        self._up_since_s[index] = min(self._up_since_s[index], stamp_s)
        if stamp_s - self._up_since_s[index] >= _BOUNCE_S:
            self._down[index] = self._held[index] = False

    @property
    def _counted(self) -> tuple[int, int]:
        return self._presses[0], self._presses[1]
