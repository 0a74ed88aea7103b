"""Invariants of each arm, as pure functions of its consecutive state records."""

import math
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from lerobot_robot_yam.arm.profile_files import load_arm
from lerobot_robot_yam.control.landing.landing_move import LANDING_SPEED_RAD_S
from lerobot_robot_yam.damiao.tables import WATCHDOG_S, Fault
from lerobot_robot_yam.state.faults import RESPONSES, Response, Trouble
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Limited
from soak.seeds import Seed

GRIPPER = load_arm("yam").joint_count
"""Index of the gripper's slot in the records of the soak's arms: the one after the joints."""
READY = frozenset({Mode.HOLD, Mode.TRACK, Mode.FLOAT})
_STANDS = frozenset({Mode.FAULT, Mode.STOPPED})
MOVES = frozenset({Mode.TRACK, Mode.FLOAT})  # modes in which a caller or a hand may move the arm
_WINDOW_S = 0.2  # window over which a speed is measured
TICK_S = 0.004
"""Period of a control loop at its usual rate, s."""
_LATE_TICKS = 2  # maximum offset of a record's stamp from the tick that moved its set-point: one tick and a late one
_JITTER_TICKS = 3  # maximum difference between a record's stamp and the clock time used by its tick
_PEER_FRESH_S = 0.02  # maximum age of a peer's record that is judged beside this arm's
_SMALL = 2e-3  # rad or strokes
_AT_MEASURED = 0.03  # rad or strokes: a set-point this close to the measured pose was seeded from it
_MISSED_S = 0.03  # a larger interval between two records means that the monitor missed some
_SETTLED_S = 0.15  # an arm that begins to land first brakes from full speed
_CAME_FREE = "a joint that came free"
_PEER_S = 0.15  # time within which a peer has been informed


@dataclass(frozen=True)
class Finding:
    """Violation of an invariant: which invariant, when, where, and a description with numbers."""

    invariant: str
    at_s: float
    channel: str
    what: str


def mode_of(record: Any) -> Mode:
    """Return the life-cycle state of a record."""
    return Mode(int(record["mode"]))


def trouble_of(record: Any) -> Trouble | None:
    """Return the trouble of a record, None if there is none."""
    text = bytes(record["trouble"]).rstrip(b"\0").decode()
    return Trouble(text) if text else None


def _stopped_in_fault(record: Any, before: Any) -> bool:
    """Return whether the emergency stop was latched between two records of an arm in FAULT, which then presses less."""
    latched = [bool(int(row["limited"]) & Limited.EMERGENCY_STOP) for row in (before, record)]
    return mode_of(before) is mode_of(record) is Mode.FAULT and latched == [False, True]


class SetPointCheck:
    """Checks that set-points neither exceed their speed limits nor jump, and that landings are not too fast.

    A jump is allowed where the set-point is deliberately seeded from the measured pose: when the mode changes (re-arm,
    end of an emergency stop, float to hold), when another process takes the arm over, when a landing meets an obstacle,
    when a joint has come free, when a motor without torque is heard again, when an emergency stop is latched for an arm
    in trouble, and for the gripper when its force limiter releases. The set-point must then be at the measured pose,
    or, in an emergency stop, at most the pressing distance `press_rad` away. In FAULT, a joint with clipped torque may
    also return to its last sent set-point, which is nearer to the arm, once its readings are rejected. Set-points of
    floating arms follow the arm and are not checked, nor are those of joints without torque, because they move nothing.

    No record can prove where the arm really was, or that a joint came free: `take_seeds` returns what must be checked.

    Args:
        channel: channel of the arm.
        limits: (7,) rad/s, the gripper's in strokes/s.
        floats: whether the arm also floats while it is stopped.
        press_rad: (7,) maximum distance between the set-point of a stopped arm and the arm.
        tick_s: period of the arm's control loop, s.
    """

    def __init__(
        self,
        channel: str,
        limits: np.ndarray,
        floats: bool = False,
        press_rad: np.ndarray | float = 0.0,
        tick_s: float = TICK_S,
    ):
        self._late_s, self._jitter_s = _LATE_TICKS * tick_s, _JITTER_TICKS * tick_s
        self._channel, self._limits, self._press_rad = channel, limits, press_rad
        self._floating = {Mode.FLOAT, Mode.STOPPED} if floats else {Mode.FLOAT}
        self._limits_landing = limits.copy()
        self._limits_landing[:GRIPPER] = np.minimum(limits[:GRIPPER], LANDING_SPEED_RAD_S)
        self._window: deque[tuple[float, float, np.ndarray]] = deque()  # previous stamp, stamp, set-point
        self._before: Any = None
        self._earlier_s = -math.inf
        self._landing_since: float | None = None
        self._unproven: list[Seed] = []
        self.largest_ratio = 0.0
        self.largest_landing_ratio = 0.0

    def take_seeds(self) -> list[Seed]:
        """Return and clear the jumps since the last call that are valid if the records are correct."""
        seeds, self._unproven = self._unproven, []
        return seeds

    def forget(self) -> None:
        """Discard the history, because a new session begins."""
        self._before, self._landing_since, self._earlier_s = None, None, -math.inf
        self._window.clear()

    def look(self, record: Any) -> list[Finding]:
        """Check one record against the previous ones."""
        before, mode = self._before, mode_of(record)
        now, setpoint = float(record["stamp_s"]), self._of(record, "setpoint").copy()
        if mode is Mode.BRING_UP:
            setpoint[GRIPPER] = math.nan  # a stroke has no meaning while the gripper stops are being searched
        self._before = record
        if mode is not Mode.LAND:
            self._landing_since = None
        elif self._landing_since is None:
            self._landing_since = now
        earlier, self._earlier_s = self._earlier_s, -math.inf if before is None else float(before["stamp_s"])
        if before is None or mode in (Mode.OFFLINE, Mode.OFF) or {mode, mode_of(before)} <= self._floating:
            self._window.clear()
            return []
        if not math.isfinite(earlier) or earlier > self._earlier_s:
            earlier = self._earlier_s - self._late_s
        setpoint[self._limp(record, before)] = math.nan
        moved = np.abs(setpoint - self._of(before, "setpoint"))
        if mode_of(before) is Mode.BRING_UP:
            moved[GRIPPER] = math.nan
        jumped = moved > self._limits * (now - earlier + self._late_s) + _SMALL
        if jumped.any():
            self._window.clear()
            return self._judge_jump(record, before, moved, jumped, now)
        if mode_of(before) in _STANDS and mode in READY and self._on_measured(record, before)[:GRIPPER].all():
            self._window.clear()  # seeded, by less than a jump: a joint without torque has sunk
            return []
        return self._judge_speed(setpoint, mode, self._earlier_s, now)

    def _of(self, record: Any, field: str) -> np.ndarray:
        """Return the slots (7,) of a record's field for which the arm has limits."""
        return record[field][: len(self._limits)]

    def _limp(self, record: Any, before: Any) -> np.ndarray:
        """Return (7,) whether each motor had no torque in both records, so that its set-point moves nothing."""
        limp: np.ndarray = (self._of(record, "fault") != Fault.NORMAL) & (self._of(before, "fault") != Fault.NORMAL)
        return limp

    def _silent_s(self, record: Any) -> np.ndarray:
        """Return the age (7,) of each motor's last accepted reply, s."""
        age_s: np.ndarray = float(record["stamp_s"]) - self._of(record, "motor_stamp_s")
        return age_s

    def _judge_jump(self, record: Any, before: Any, moved: np.ndarray, jumped: np.ndarray, now: float) -> list[Finding]:
        old, new = mode_of(before), mode_of(record)
        seeded = bool(self._on_measured(record, before)[jumped].all())
        taken_over = record["owner_pid"] != before["owner_pid"]
        let_go = not jumped[:GRIPPER].any() and bool(int(before["limited"]) & Limited.GRIPPER_FORCE)
        caught = bool(int(record["limited"]) & Limited.CAME_FREE)
        why = ""
        if let_go:
            why = "gripper, as its force limiter lets go"
        elif _stopped_in_fault(record, before):
            why = "an arm in trouble, at an emergency stop"
        elif old is not new or taken_over or new in (Mode.LAND, Mode.BRING_UP):
            why = f"{old.name} → {new.name}"
        elif caught:
            why = _CAME_FREE
        elif old is Mode.FAULT and (self._silent_s(before)[jumped] > WATCHDOG_S).all():
            why = "a motor unheard for longer than its watchdog, re-enabled"
        if seeded and why:
            if new is not Mode.FLOAT:  # a floating joint receives no set-point
                self._note_seed(record, before, jumped, why)
            return []
        clipped = old is new is Mode.FAULT and bool(int(before["limited"]) & Limited.TORQUE)
        if (new is Mode.LAND or clipped) and self._presses_less(record, before)[jumped].all():
            return []  # a landing met an obstacle, or readings were rejected and the joint kept its last sent set-point
        slot = int(np.nanargmax(np.where(jumped, moved, 0.0)))
        way = f"{before['setpoint'][slot]:.3f} to {record['setpoint'][slot]:.3f}, measured {record['q'][slot]:.3f}"
        took_s = now - float(before["stamp_s"])
        what = f"slot {slot} from {way} within {took_s:.4f} s, {old.name} → {new.name}"
        return [Finding("no set-point jump", now, self._channel, what)]

    def _note_seed(self, record: Any, before: Any, jumped: np.ndarray, why: str) -> None:
        joints = slice(GRIPPER)
        self._unproven.append(
            Seed(
                at_s=float(record["stamp_s"]),
                why=why,
                free=why == _CAME_FREE,
                joints=jumped[joints],
                setpoint=record["setpoint"][joints].copy(),
                within_rad=self._within_rad(record, before)[joints],
                age_s=float(record["stamp_s"]) - record["motor_stamp_s"][joints],
                gap_s=float(record["stamp_s"] - before["stamp_s"]),
            )
        )

    def _presses_less(self, record: Any, before: Any) -> np.ndarray:
        """Return (7,) whether each set-point moved closer to the arm's pose, and not past it."""
        here, now, then = self._of(record, "q"), self._of(record, "setpoint"), self._of(before, "setpoint")
        nearer: np.ndarray = (now - here) * (now - then) <= 0.0
        return nearer

    def _on_measured(self, record: Any, before: Any) -> np.ndarray:
        """Return (7,) whether each set-point is at the arm's pose in either record, or between both after a gap."""
        setpoint, here, there = self._of(record, "setpoint"), self._of(record, "q"), self._of(before, "q")
        beside = np.minimum(np.abs(setpoint - here), np.abs(setpoint - there))
        if float(record["stamp_s"]) - float(before["stamp_s"]) > _MISSED_S:
            beside[(setpoint - here) * (setpoint - there) < 0.0] = 0.0
        on_measured: np.ndarray = beside < self._within_rad(record, before)
        return on_measured

    def _within_rad(self, record: Any, before: Any) -> np.ndarray:
        """Return (7,) the maximum distance from the arm for a set-point that was seeded from the arm's pose."""
        moving = np.nan_to_num(np.abs(self._of(record, "dq"))) * self._jitter_s
        presses = mode_of(record) is Mode.STOPPED or _stopped_in_fault(record, before)
        within: np.ndarray = _AT_MEASURED + moving + (self._press_rad if presses else 0.0)
        return within

    def _judge_speed(self, setpoint: np.ndarray, mode: Mode, before_s: float, now: float) -> list[Finding]:
        window = self._window
        window.append((before_s, now, setpoint))
        while len(window) > 2 and now - window[1][1] >= _WINDOW_S:
            window.popleft()
        # A record shows the set-point of the previous tick, so the motion began with the record before the first.
        since, stamp, first = window[0]
        if now - stamp < _WINDOW_S:
            return []
        moved = np.abs(setpoint - first)
        allowed = now - since + self._jitter_s
        ratio = np.nan_to_num((moved - _SMALL) / (self._limits * allowed))
        self.largest_ratio = max(self.largest_ratio, float(ratio.max()))
        found = []
        if ratio.max() > 1.0:
            slot = int(ratio.argmax())
            what = f"slot {slot}, {moved[slot] / (now - since):.2f} of {self._limits[slot]:.2f} per second, {mode.name}"
            found.append(Finding("set-point speed", now, self._channel, what))
        if self._landing_since is not None and since - self._landing_since > _SETTLED_S:
            landing = np.nan_to_num((moved - _SMALL) / (self._limits_landing * allowed))[:GRIPPER]
            self.largest_landing_ratio = max(self.largest_landing_ratio, float(landing.max()))
            if landing.max() > 1.0:
                slot = int(landing.argmax())
                what = f"joint_{slot + 1} lands at {moved[slot] / (now - since):.2f} rad/s"
                found.append(Finding("landing speed", now, self._channel, what))
        return found


class PolicyCheck:
    """Checks that an arm in trouble, and the robot's other arm, respond as `faults.RESPONSES` specifies.

    Args:
        peers: the other arm of the same robot, by channel.
    """

    def __init__(self, peers: Mapping[str, str]):
        self._peers = peers
        self._trouble: dict[str, Trouble | None] = {}
        self._since: dict[str, float] = {}
        self._landing_s: dict[str, float] = {}  # when the arm began to land
        self._told: set[str] = set()  # channels whose present trouble is reported or exempt
        self.outcomes: Counter[tuple[str, str]] = Counter()

    def look(self, channel: str, record: Any, peer: Any) -> tuple[list[Finding], tuple[Trouble, float] | None]:
        """Check one record of an arm against the latest record of its peer (None without one).

        Returns:
            Violations; newly reported trouble and the earliest time at which it may have begun. A landing arm does not
            report motors whose readings it rejects until the landing is stopped.
        """
        trouble, mode, now = trouble_of(record), mode_of(record), float(record["stamp_s"])
        found: list[Finding] = []
        news = None
        if mode is Mode.LAND:
            self._landing_s.setdefault(channel, now)
        elif mode not in (Mode.STOPPED, Mode.FAULT):
            self._landing_s.pop(channel, None)
        if trouble is not self._trouble.get(channel):
            self._trouble[channel], self._since[channel] = trouble, now
            self._told.discard(channel)
            if trouble is not None:
                news = trouble, self._landing_s.get(channel, now)
                self.outcomes[(trouble, mode.name)] += 1
                found += _judge_arm(channel, trouble, mode, now)
        if trouble is None or RESPONSES[trouble].peer is not Response.HOLD or channel in self._told or peer is None:
            return found, news
        there = mode_of(peer)
        if trouble_of(peer) is not None:  # the operator re-arms both arms, one after the other
            self._told.add(channel)
        elif now - self._since[channel] > _PEER_S and there in MOVES and float(peer["stamp_s"]) > now - _PEER_FRESH_S:
            self._told.add(channel)
            what = f"{self._peers[channel]} is in {there.name} while {channel} has trouble: {trouble}"
            found.append(Finding("the other arm as the policy says", now, channel, what))
        return found, news


def _judge_arm(channel: str, trouble: Trouble, mode: Mode, now: float) -> list[Finding]:
    expected = {
        Response.HOLD: {Mode.FAULT},
        Response.LOST: {Mode.FAULT},
        Response.LAND: {Mode.LAND, Mode.OFF, Mode.STOPPED},
    }.get(RESPONSES[trouble].arm, set())
    if mode in expected | {Mode.LAND, Mode.OFF}:  # an arm that is already landing continues
        return []
    return [Finding("the arm as the policy says", now, channel, f"{trouble}: it is in {mode.name}")]
