"""Arms stop when they are told to, and when nobody tells them anything any more."""

import math
from typing import Any

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.state.modes import Mode
from soak.checks import Finding, mode_of

_STILL = frozenset({Mode.STOPPED, Mode.FAULT, Mode.OFF, Mode.OFFLINE})
_STOP_S = 0.1  # in which an emergency stop has reached every arm
_LATE_S = 0.1  # a tick, and a take-over
_MOMENT_S = 0.03  # who takes an arm over says how it found it before it decides


class ObedienceCheck:
    """Feed it every record of one arm, in order."""

    def __init__(self, channel: str):
        self._channel = channel
        self._target, self._target_s = -1, 0.0
        self._wrong_since_s, self._told = math.inf, False
        self.stops = self.silences = 0  # that were seen to be obeyed

    def look(self, record: Any, stopped_since_s: float | None) -> list[Finding]:
        """Check one record; `stopped_since_s`: since when the emergency stop has been latched, None: it is not."""
        mode, now = mode_of(record), float(record["stamp_s"])
        if int(record["target_sequence"]) != self._target or record["coupled_to"]:
            # A coupled follower's targets come from its leader; for how long after the caller's word, `coupled` judges.
            self._target, self._target_s = int(record["target_sequence"]), now
        stopped = stopped_since_s is not None and now > stopped_since_s + _STOP_S
        silent = now > self._target_s + ArmConfig.command_timeout_s + _LATE_S
        found = []
        if stopped and mode not in _STILL:
            found.append(Finding("an emergency stop stops", now, self._channel, f"it is in {mode.name}"))
        if silent and mode is Mode.TRACK:
            what = f"no target for {now - self._target_s:.2f} s"
            found.append(Finding("a silent caller's arm holds", now, self._channel, what))
        self._wrong_since_s = min(self._wrong_since_s, now) if found else math.inf
        if not found:
            self._told = False
        elif self._told or now - self._wrong_since_s < _MOMENT_S:
            found = []
        else:
            self._told = True
        self.stops += stopped and mode is Mode.STOPPED
        self.silences += silent and mode is Mode.HOLD
        return found
