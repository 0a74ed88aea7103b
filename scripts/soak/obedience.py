"""Check that arms stop at an emergency stop, and hold when the caller falls silent."""

import math
from typing import Any

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.state.modes import Mode
from soak.checks import Finding, mode_of

_STILL = frozenset({Mode.STOPPED, Mode.FAULT, Mode.OFF, Mode.OFFLINE})
_STOP_S = 0.1  # time within which an emergency stop reaches every arm
_LATE_S = 0.1  # one tick, and a take-over
_MOMENT_S = 0.03  # a process that takes an arm over first reports the state found, then decides


class ObedienceCheck:
    """Check of one arm, fed with all of its records in order."""

    def __init__(self, channel: str):
        self._channel = channel
        self._target, self._target_s = -1, 0.0
        self._wrong_since_s, self._told = math.inf, False
        self.stops = self.silences = 0  # number of records in which the arm obeyed

    def look(self, record: Any, stopped_since_s: float | None) -> list[Finding]:
        """Check one record; stopped_since_s: time since which the emergency stop is latched, None if it is not."""
        mode, now = mode_of(record), float(record["stamp_s"])
        if int(record["target_sequence"]) != self._target or record["coupled_to"]:
            # A coupled follower's targets come from its leader; `coupled` judges the age of the caller's permission.
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
