"""A follower that follows its leader at loop rate: only with its caller's leave, only while that leads, and only it."""

import math
from collections import Counter
from typing import Any

import numpy as np

from lerobot_robot_yam.state.modes import Gate, Mode
from soak.checks import GRIPPER, Finding, mode_of

_LEAVE_S = 0.2  # 0.1 s and one frame of the caller, which counts as 0.1 s at most
_LOST_S = 0.08  # a state counts for 0.03 s, and a follower comes to rest within 0.05 s after that
_LATE_S = 0.03  # some late ticks, after which a loop looks at the clock anew
_LEADS = (Mode.FLOAT, Mode.HOLD, Mode.TRACK)
_JOINED_S = 4.0  # a gap of 1.5 rad is closed by then
_ASKED_RAD, _ASKED_S = 0.02, 0.05  # between what both say: ticks that lie apart, and a speed that changes meanwhile
_STEP_S = 0.1  # a gate that opens, or closes, may have its target step: the follower is asked so a tick later


class CouplingCheck:
    """Feed it the records of one follower, in order, with the newest one of its leader that was read after it.

    It does not see all of them: who reads them is late now and then. So it knows by their ticks where one is missing.

    Args:
        channel: the follower's.

    Attributes:
        records: of it while it was coupled.
        unseen: how often it may have come apart and joined again in a record that is missing.
        gates: how often its leader's gate became each.
    """

    def __init__(self, channel: str):
        self._channel = channel
        self._target, self._target_s = -1, -math.inf
        self._led_s = self._apart_s = -math.inf  # when the leader last led; when it last was asked what that asks
        self._joined_s = math.inf  # since when it has been coupled
        self._tick, self._is_apart = 0, False  # at the last look
        self._gate: Gate | None = None
        self._told: set[str] = set()  # what has been said of this time of being coupled
        self.records = self.unseen = 0
        self.gates: Counter[str] = Counter()

    def look(self, record: Any, leader: Any) -> list[Finding]:
        """Check one record; `leader`: None while it has none, before the first one and after its process was killed."""
        now = float(record["stamp_s"])
        missed = int(record["tick"]) - self._tick > 1
        self._tick = int(record["tick"])
        if int(record["target_sequence"]) != self._target:
            self._target, self._target_s = int(record["target_sequence"]), now
        if leader is not None:
            self._note_gate(Gate(int(leader["gate"])))
            if mode_of(leader) in _LEADS and np.isfinite(leader["action"][:GRIPPER]).all():
                self._led_s = max(self._led_s, float(leader["stamp_s"]))
        if not record["coupled_to"]:
            self._joined_s, self._told, self._is_apart = math.inf, set(), False
            return []
        self.records += 1
        if self._joined_s == math.inf:
            self._joined_s = self._apart_s = now
            self._led_s = max(self._led_s, now)  # it joins a leader that may lead no more in the record read after it
        wrong = {}
        if now - self._target_s > _LEAVE_S + _LATE_S:
            wrong["a follower is led with its caller's leave"] = f"the last one is {now - self._target_s:.3f} s old"
        if now - self._led_s > _LOST_S + _LATE_S:
            wrong["a follower is led by a leader that leads"] = f"that led {now - self._led_s:.3f} s ago"
        elif apart := self._apart(record, leader, now, missed):
            wrong["a follower is asked what its leader asks"] = apart
        found = [Finding(name, now, self._channel, what) for name, what in wrong.items() if name not in self._told]
        self._told |= set(wrong)
        return found

    def _note_gate(self, gate: Gate) -> None:
        if self._gate not in (None, gate):
            self.gates[gate.name.lower()] += 1
        self._gate = gate

    def _apart(self, record: Any, leader: Any, now: float, missed: bool) -> str:
        """What a follower that has caught up is asked for too long, and its leader does not ask; empty: nothing."""
        joints = slice(GRIPPER)
        if now - self._joined_s < _JOINED_S or leader is None:
            self._apart_s = now
            return ""
        rate = leader["action_dq"][joints]
        asks = leader["action"][joints] + rate * (now - leader["action_stamp_s"])
        gap = np.abs(record["action"][joints] - asks)
        before, self._is_apart = self._is_apart, bool((gap > _ASKED_RAD + _ASKED_S * np.abs(rate)).any())
        if not self._is_apart:
            self._apart_s = now
        elif missed and not before:  # its leader was late, it has come apart, and joined again: it has to catch up
            self._joined_s = self._apart_s = now
            self.unseen += 1
        if now - self._apart_s < _STEP_S:
            return ""
        joint = int(gap.argmax())
        return f"joint_{joint + 1}: {record['action'][joint]:.3f} where its leader asks {asks[joint]:.3f} rad"
