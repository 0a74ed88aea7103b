"""Faults of the soak of a mobile robot: the soak's schedule with base in place of leaders, and faults of the rail."""

import random
from collections import Counter, deque
from typing import Any

from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.faults import Trouble
from soak.injected_faults import FOLLOWERS, LEADERS, RANDOM
from soak.schedule import Injection, make_schedule

BASE, BOARD = "base", "base_io"
KINDS = [name for name, kind in RANDOM.items() if kind.rig and name != "handle_silent"]
KINDS += ["caller_stall", "emergency_stop"]
RAIL_FAULTS: dict[str, list[Any]] = {  # on the board of switches and brake: kind -> values
    "switches": [{"upper": True}, {"lower": True}, {"upper": True, "lower": True}, {"lower": False}],
    "handle_silent": [True],
    "brake_slips": [True],
}
_RAIL_GAP_S, _RAIL_FAULT_S = 40.0, 1.5  # mean time between two faults of the board, and duration of one, s
_EXPLAINS_S = 2.0  # time after its end in which a fault explains a trouble, s
_AFTER_S = 4.5  # time after its end in which a fault excuses a part that moves, s


class MobileFaults:
    """Injected faults of one run.

    Attributes:
        injected: number of faults by kind.
        stall_s: time until which the caller stalls, s. stop_s: time until which the emergency stop is latched, s.
        newest_s: time of the last beginning or end of a fault, s.
    """

    def __init__(self, rig: LockstepRig, seconds: float, seed: int, pace: float):
        self._rig, self._pace = rig, pace
        self._schedule = deque(make_schedule(seconds, seed, pace, KINDS))
        self._open: list[tuple[float, Injection]] = []  # end of each fault that lasts, and the fault
        self._recent: deque[tuple[float, Injection]] = deque(maxlen=200)  # begin or end of each fault
        self._chance = random.Random(f"{seed} rail")
        self._rail_s, self._rail_fault, self._rail_ended_s = self._chance.expovariate(pace / _RAIL_GAP_S), "", -10.0
        self.injected: Counter[str] = Counter()
        self.stall_s = self.stop_s = self.newest_s = 0.0

    def pending(self, now: float) -> bool:
        """Return whether a fault lasts."""
        return bool(self._open or self._rail_fault or self.stop_s) or now < self.stall_s

    def advance(self, now: float, connected: bool) -> None:
        """End and begin the faults that are due; those of a robot that is not connected are left out."""
        for end_s, row in [pair for pair in self._open if pair[0] <= now]:
            self._open.remove((end_s, row))
            self._rig.fault(*_place(row), RANDOM[row.kind].rig, RANDOM[row.kind].usual)
            self._note(now, row)
        while self._schedule and self._schedule[0].at_s <= now:
            row = self._schedule.popleft()
            if connected:
                self._begin(row, now)
        if self.stop_s and now >= self.stop_s:
            EmergencyStop().release()
            self.stop_s, self.newest_s = 0.0, now
        if now >= self._rail_s and (connected or self._rail_fault):
            self._advance_rail(now)

    def _begin(self, row: Injection, now: float) -> None:
        self.injected[row.kind] += 1
        if row.kind == "caller_stall":
            self.stall_s = now + row.seconds
        elif row.kind == "emergency_stop":
            EmergencyStop().latch("the soak")
            self.stop_s = now + row.seconds
        else:
            value = True if row.value is None else row.value
            self._rig.fault(*_place(row), RANDOM[row.kind].rig, value, **RANDOM[row.kind].details)
            if row.seconds:
                self._open.append((now + row.seconds, row))
        self._note(now, row)

    def _note(self, now: float, row: Injection) -> None:
        self._recent.append((now, row))
        self.newest_s = now

    def _advance_rail(self, now: float) -> None:
        self.newest_s = now
        if self._rail_fault:
            self._rig.fault(BOARD, None, self._rail_fault, False)
            self._rail_fault, self._rail_ended_s = "", now
            self._rail_s = now + self._chance.expovariate(self._pace / _RAIL_GAP_S)
            return
        self._rail_fault = self._chance.choice(list(RAIL_FAULTS))
        self._rig.fault(BOARD, None, self._rail_fault, self._chance.choice(RAIL_FAULTS[self._rail_fault]))
        self.injected[f"rail {self._rail_fault}"] += 1
        self._rail_s = now + _RAIL_FAULT_S

    def end(self) -> None:
        """End all faults."""
        self._schedule.clear()
        self._open.clear()
        self._rail_fault = ""
        self.clear()
        EmergencyStop().release()

    def clear(self) -> None:
        """Clear what is left of faults in the rig."""
        for channel in (*FOLLOWERS, BASE, BOARD):
            self._rig.clear_faults(channel)

    def _rows(self, name: str, now: float, for_s: float) -> list[Injection]:
        recent = [row for at_s, row in self._recent if now - at_s < for_s]
        return [row for row in (*recent, *(row for _, row in self._open)) if _place(row)[0] == name]

    def explain(self, name: str, trouble: Trouble, now: float) -> bool:
        """Return whether a recent fault can have caused the trouble of a part."""
        rail = self._rail_fault or now - self._rail_ended_s < _EXPLAINS_S
        if name == BASE and rail and trouble.name.startswith("RAIL"):
            return True
        return any(trouble in RANDOM[row.kind].troubles for row in self._rows(name, now, _EXPLAINS_S))

    def cut(self, name: str, now: float) -> bool:
        """Return whether a fault keeps commands from the part or takes a motor's torque, or has done so recently."""
        return any(RANDOM[row.kind].cuts or row.kind == "motor_fault" for row in self._rows(name, now, _AFTER_S))

    def lie(self, name: str, now: float) -> bool:
        """Return whether readings of the part may be false."""
        return bool(self._rows(name, now, 0.5))


def _place(row: Injection) -> tuple[str, Any]:
    """Return channel and motor of a fault; what the schedule gives the leaders goes to the base."""
    if row.channel not in LEADERS:
        return row.channel, row.motor or None
    number = 7 if row.motor == "gripper" else int(row.motor[-1]) if row.motor else None
    return BASE, number
