"""The gate between leaders and their followers: a state machine without clock, I/O or motion.

`TABLE` has every transition. What a state makes leader and follower do is in `lead`.
"""

import logging
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from lerobot_robot_yam.arm.leaders.lead_config import GateKind, LeadConfig
from lerobot_robot_yam.state.modes import Gate

logger = logging.getLogger(__name__)

CAUGHT_UP_RAD = 0.05  # so near to the leader the follower is there
LEFT_BEHIND_RAD = 0.1  # a follower that does not follow, and is farther away, has to approach again
_ROUNDING_S = 1e-6
LIFTED_RAD = 0.15  # so far a hand lifts a leader against its way home to break that off


class Look(NamedTuple):
    """What one arm's gate depends on, at one tick.

    Attributes:
        away_rad: the leader's distance from home.
        home: leader and follower are there.
        gap_rad: from the follower to where the leader wants it.
        follows: the follower takes this leader's targets.
        approached: the approach has run its time.
        recentred: the leader is back at the follower.
        pressed, fine_pressed: the gate's button and that of fine mode have just gone down.
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
"""State, condition, next state; of several conditions that hold the first counts."""

START: dict[GateKind, Gate] = {"auto": Gate.HOMING, "button": Gate.IDLE, "always": Gate.APPROACH}


class GateMachine:
    """The gate of one leader, or of both leaders of a robot together.

    Attributes:
        state: the present one.
        because: the condition that has led to it.
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
        """Begin anew: an arm was stopped or has failed. Whether that is another state."""
        self._below_since_s, self._least_rad = math.inf, []
        return self._enter(self._start, "cannot_lead")

    def advance(self, now: float, looks: Sequence[Look]) -> bool:
        """One tick, with a look at each of its arms; whether the state has changed. At most one transition."""
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
        """Each leader is lifted off its way home, farther than the way has brought it."""
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
    """The gate of the leaders that move through it together, or of one.

    The last of them advances it, unless one of them has nothing to say; for the others a transition comes one tick
    later.
    """

    def __init__(self, machine: GateMachine, names: Sequence[str]):
        self.machine, self._name = machine, " and ".join(names)
        self._looks: list[Look | None] = [None] * len(names)

    def advance(self, now: float, index: int, look: Look) -> Gate:
        """Take the look of arm `index` at this tick; the state that counts for it."""
        self._looks[index] = look
        if index == len(self._looks) - 1:
            before, looks = self.machine.state, [look for look in self._looks if look is not None]
            if len(looks) == len(self._looks) and self.machine.advance(now, looks):
                self._tell(before)
        return self.machine.state

    def miss(self, index: int) -> None:
        """Arm `index` has nothing to say at this tick: wait for it."""
        self._looks[index] = None

    def restart(self) -> Gate:
        """An arm cannot lead any more: begin anew."""
        before = self.machine.state
        if self.machine.restart():
            self._tell(before)
        return self.machine.state

    def _tell(self, before: Gate) -> None:
        now, because = self.machine.state.name.lower(), self.machine.because.replace("_", " ")
        logger.info("%s: gate: %s -> %s (%s)", self._name, before.name.lower(), now, because)
