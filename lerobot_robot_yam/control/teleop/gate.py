"""The gate between leaders and their followers: a state machine without clock, I/O or motion.

`TABLE` lists all transitions. The module `lead` defines the motion of leader and follower in each state.
"""

import logging
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from lerobot_robot_yam.arm.leaders.lead_config import GateKind, LeadConfig
from lerobot_robot_yam.state.modes import Gate

logger = logging.getLogger(__name__)

CAUGHT_UP_RAD = 0.05  # maximum gap between a follower that has arrived and its target
LEFT_BEHIND_RAD = 0.1  # gap above which a follower that takes no targets must approach again
_ROUNDING_S = 1e-6
LIFTED_RAD = 0.15  # distance against the homing motion by which a hand ends the homing


class Look(NamedTuple):
    """Gate inputs from one arm at one tick.

    Attributes:
        away_rad: the leader's distance from home.
        home: whether leader and follower are at home.
        gap_rad: distance between the follower and its target.
        follows: whether the follower takes this leader's targets.
        approached: whether the planned time of the approach is over.
        recentred: whether the leader is back at the follower's position.
        pressed, fine_pressed: whether the gate button and the fine-mode button were pressed at this tick.
    """

    away_rad: float = 0.0
    home: bool = False
    gap_rad: float = 0.0
    follows: bool = False
    approached: bool = False
    recentred: bool = False
    pressed: bool = False
    fine_pressed: bool = False


_OPEN = (Gate.APPROACH, Gate.ENGAGED, Gate.FINE, Gate.RECENTRE)
Rule = tuple[Gate, str, Gate]

_TRACKING: tuple[Rule, ...] = (
    (Gate.APPROACH, "caught_up", Gate.ENGAGED),
    (Gate.ENGAGED, "left_behind", Gate.APPROACH),
    (Gate.ENGAGED, "fine_pressed", Gate.FINE),
    (Gate.FINE, "left_behind", Gate.APPROACH),
    (Gate.FINE, "fine_pressed", Gate.RECENTRE),
    (Gate.RECENTRE, "left_behind", Gate.APPROACH),
    (Gate.RECENTRE, "recentred", Gate.APPROACH),
    (Gate.RECENTRE, "fine_pressed", Gate.APPROACH),
)
TABLE: dict[GateKind, tuple[Rule, ...]] = {
    "auto": (
        (Gate.HOMING, "lifted", Gate.APPROACH),
        (Gate.HOMING, "home", Gate.IDLE),
        (Gate.IDLE, "away", Gate.APPROACH),
        *((state, "released", Gate.HOMING) for state in _OPEN),
        *_TRACKING,
    ),
    "button": (
        (Gate.IDLE, "pressed", Gate.APPROACH),
        *((state, "pressed", Gate.IDLE) for state in _OPEN),
        *_TRACKING,
    ),
    "always": _TRACKING,
}
"""Per gate kind: (state, condition, next state); if several conditions hold, the first row applies."""

START: dict[GateKind, Gate] = {"auto": Gate.HOMING, "button": Gate.IDLE, "always": Gate.APPROACH}


class GateMachine:
    """State machine of a gate, for one leader or for both leaders of a robot together.

    Attributes:
        state: the present state.
        because: name of the condition that caused the last transition.
    """

    def __init__(self, config: LeadConfig):
        self._engage_rad, self._release_rad = config.engage_threshold_rad, config.release_threshold_rad
        self._release_s, self._start = config.release_s, START[config.gate]
        self._rules: dict[Gate, list[tuple[Callable[[Sequence[Look], float], bool], str, Gate]]] = {}
        for state, condition, to in TABLE[config.gate]:
            self._rules.setdefault(state, []).append((getattr(self, f"_{condition}"), condition, to))
        self._below_since_s = math.inf
        self._least_rad: list[float] = []
        self.state, self.because = self._start, "start"

    def restart(self) -> bool:
        """Return to the initial state after a stop or fault of an arm; return whether the state has changed."""
        self._below_since_s, self._least_rad = math.inf, []
        return self._enter(self._start, "cannot_lead")

    def advance(self, now: float, looks: Sequence[Look]) -> bool:
        """Process each arm's inputs of one tick, with at most one transition; return whether the state has changed."""
        below = all(look.away_rad < self._release_rad for look in looks)
        self._below_since_s = min(self._below_since_s, now) if below else math.inf
        if self.state is Gate.HOMING:
            least = self._least_rad or [look.away_rad for look in looks]
            self._least_rad = [min(a, look.away_rad) for a, look in zip(least, looks, strict=True)]
        for holds, condition, to in self._rules.get(self.state, ()):
            if holds(looks, now):
                return self._enter(to, condition)
        return False

    def _enter(self, state: Gate, because: str) -> bool:
        changed, self.state = state is not self.state, state
        if changed:
            self.because, self._least_rad = because, []
        return changed

    def _lifted(self, looks: Sequence[Look], _: float) -> bool:
        """Return whether each leader was moved away from home by hand, against its homing motion."""
        pairs = zip(looks, self._least_rad, strict=True)
        return all(look.away_rad > max(self._engage_rad, least + LIFTED_RAD) for look, least in pairs)

    def _away(self, looks: Sequence[Look], _: float) -> bool:
        return all(look.away_rad > self._engage_rad for look in looks)

    def _released(self, _: Sequence[Look], now: float) -> bool:
        return now - self._below_since_s > self._release_s - _ROUNDING_S

    def _home(self, looks: Sequence[Look], _: float) -> bool:
        return all(look.home for look in looks)

    def _caught_up(self, looks: Sequence[Look], _: float) -> bool:
        return all(look.follows and look.approached and look.gap_rad < CAUGHT_UP_RAD for look in looks)

    def _left_behind(self, looks: Sequence[Look], _: float) -> bool:
        return any(not look.follows and look.gap_rad > LEFT_BEHIND_RAD for look in looks)

    def _recentred(self, looks: Sequence[Look], _: float) -> bool:
        return all(look.recentred for look in looks)

    def _pressed(self, looks: Sequence[Look], _: float) -> bool:
        return any(look.pressed for look in looks)

    def _fine_pressed(self, looks: Sequence[Look], _: float) -> bool:
        return any(look.fine_pressed for look in looks)


class SharedGate:
    """Gate shared by several leaders, or used by one leader.

    The call for the last arm advances the state machine, unless an arm had no inputs at this tick; the other arms see a
    transition one tick later.
    """

    def __init__(self, machine: GateMachine, names: Sequence[str]):
        self.machine, self._name = machine, " and ".join(names)
        self._looks: list[Look | None] = [None] * len(names)

    def advance(self, now: float, index: int, look: Look) -> Gate:
        """Store the inputs of arm `index` for this tick; return the gate's state for that arm."""
        self._looks[index] = look
        if index == len(self._looks) - 1:
            before, looks = self.machine.state, [look for look in self._looks if look is not None]
            if len(looks) == len(self._looks) and self.machine.advance(now, looks):
                self._tell(before)
        return self.machine.state

    def miss(self, index: int) -> None:
        """Record that arm `index` has no inputs at this tick, so that the gate does not advance."""
        self._looks[index] = None

    def restart(self) -> Gate:
        """Return to the initial state because an arm cannot lead any more; return the state."""
        before = self.machine.state
        if self.machine.restart():
            self._tell(before)
        return self.machine.state

    def _tell(self, before: Gate) -> None:
        now, because = self.machine.state.name.lower(), self.machine.because.replace("_", " ")
        logger.info("%s: gate: %s -> %s (%s)", self._name, before.name.lower(), now, because)
