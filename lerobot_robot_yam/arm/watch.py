"""Who on the channel has stopped to answer or to obey."""

import logging
import math

import numpy as np

from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.encoder import HandleEncoder
from lerobot_robot_yam.damiao.tables import Fault, fault_text

logger = logging.getLogger(__name__)

_MOTOR_SILENT_S = 0.1  # a motor that has not answered for so long is lost: a quarter of its own watchdog
_MOTOR_MISSED = 10  # and has let so many questions in a row go by: a machine that stood still has not asked
_HANDLE_SILENT_S = 0.25


class MotorWatch:
    """Which motors of a chain are silent or do not obey. Ask once per tick."""

    def __init__(self, chain: MotorChain):
        self._chain = chain
        self._stamp_s = chain.stamp_s
        self._lost_before = chain.lost

    def check(self, now: float) -> tuple[np.ndarray, str]:
        """(n,) bool, motors in trouble, and a message that names each with its reason."""
        chain = self._chain
        answered = chain.stamp_s > self._stamp_s
        self._stamp_s = chain.stamp_s
        self._lost_before = np.where(answered, chain.lost, self._lost_before)
        silent = (now - chain.stamp_s > _MOTOR_SILENT_S) & (chain.lost - self._lost_before >= _MOTOR_MISSED)
        bad = silent | (chain.fault != Fault.NORMAL)
        if not bad.any():
            return bad, ""
        parts = []
        for index in np.flatnonzero(bad):
            motor = chain.motors[index]
            age = now - chain.stamp_s[index]
            why = f"silent for {age:.2f} s" if silent[index] else fault_text(int(chain.fault[index]))
            parts.append(f"{motor.name} (id {motor.can_id}): {why}")
        return bad, "; ".join(parts)


class HandleWatch:
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
        silent = now - encoder.stamp_s > _HANDLE_SILENT_S
        if silent and not self._was_silent:
            logger.warning("%s: the teaching handle is silent; its trigger and buttons are unknown", self._arm)
        self._was_silent = silent
        if silent:
            return math.nan, (False, False), encoder.stamp_s
        return encoder.report.trigger, encoder.report.buttons, encoder.stamp_s
