"""Check of a follower coupled at loop rate: permitted by its caller, led by an active leader, and following only it."""

import math
from collections import Counter
from typing import Any

import numpy as np

from lerobot_robot_yam.state.modes import Gate, Mode
from soak.checks import GRIPPER, Finding, mode_of

_LEAVE_S = 0.5  # validity of the caller's permission: `command_timeout_s`
_LOST_S = 0.08  # a leader state is valid for 0.03 s, and the follower comes to rest within another 0.05 s
_LATE_S = 0.03  # a few late ticks, after which a loop reads the clock again
_LEADS = (Mode.FLOAT, Mode.HOLD, Mode.TRACK)
_JOINED_S = 4.0  # time within which a gap of 1.5 rad is closed
_ASKED_RAD, _ASKED_S = 0.02, 0.05  # tolerance between both records, whose ticks and speeds may differ
_STEP_S = 0.1  # an opening or closing gate may make the target jump; the follower receives the jump a tick later


class CouplingCheck:
    """Check of one follower, fed with its records in order, each with the leader's latest record, read afterwards.

    The check misses some records, because the reader is sometimes late. It detects missing records by their ticks.

    Args:
        channel: channel of the follower.

    Attributes:
        records: number of records while the follower was coupled.
        unseen: number of times that the follower may have separated and rejoined in a missing record.
        gates: number of times that the leader's gate entered each state.
    """

    def __init__(self, channel: str):
        self._channel = channel
        self._target, self._target_s = -1, -math.inf
        self._led_s = self._apart_s = -math.inf  # when the leader last led; when both targets last agreed
        self._joined_s = math.inf  # time at which the coupling began
        self._tick, self._before_s, self._is_apart = 0, -math.inf, False  # at the previous record
        self._gate: Gate | None = None
        self._told: set[str] = set()  # findings already reported for this coupling
        self.records = self.unseen = 0
        self.gates: Counter[str] = Counter()

    def look(self, record: Any, leader: Any) -> list[Finding]:
        """Check one record. leader: its leader's record, None before the first and after the leader's process died."""
        now = float(record["stamp_s"])
        missed = int(record["tick"]) - self._tick > 1
        self._tick = int(record["tick"])
        if now - self._before_s > _LATE_S:  # what the leader did meanwhile was not seen
            self._led_s = now
        self._before_s = now
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
            self._led_s = max(self._led_s, now)  # the record read afterwards may show a leader that no longer leads
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
        """Return how the target of a follower that has caught up differs from its leader's for too long, or ""."""
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
        elif missed and not before:  # the leader was late, the follower separated and rejoined: it must catch up again
            self._joined_s = self._apart_s = now
            self.unseen += 1
        if now - self._apart_s < _STEP_S:
            return ""
        joint = int(gap.argmax())
        return f"joint_{joint + 1}: {record['action'][joint]:.3f} where its leader asks {asks[joint]:.3f} rad"
