"""Landing: bring the arm down under control to where cutting torque moves nothing.

    fold    to the folded pose with the wrist raised; an arm that lies already stays (`fold`)
    lower   the wrist down to its resting place, stopping at contact
    fade    or sink: stiffness and feed-forward to nothing; whatever is still unsupported sinks slowly (`sink`)

An arm without one of the motors that carry it may never get there, since a limp wrist stands in its way. It sinks onto
what it has met on its way down. It also sinks, and does not fade, if one is out at the end of `lower`: nobody knows
where its joint is then.

An arm whose base is tilted, or whose resting pose is configured, does not lie there. From there it sinks to where it
hangs or lies, and torque is cut when nothing moves any more.
"""

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.landing.fold import Fold
from lerobot_robot_yam.control.landing.landing_move import LandingMove, Patience, Phase, Seen
from lerobot_robot_yam.control.landing.sink import Sink
from lerobot_robot_yam.control.laws.set_point import SetPoint

_LIES_RAD = 0.06  # distance from the resting pose of an arm that lies already
_CONTACT_RAD, _CONTACT_S = 0.12, 0.1  # error of a wrist that has met something while it is lowered


class Landing:
    """One landing of the arm joints (n,).

    Args:
        hardware: the arm. Where it does not lie at its resting pose, it sinks from there to where it hangs or lies.
        q: (n,) rad, where the arm is.
        setpoint: the arm's set-point; its limits are lowered for good.
        now: monotonic s.

    Attributes:
        phase: the present one.
        learns: the arm learns the torque that its model misses.
    """

    def __init__(self, hardware: ResolvedArm, q: np.ndarray, setpoint: SetPoint, now: float):
        rest = hardware.rest_q.copy()
        if hardware.folding.base is not None and hardware.lies_at_rest:
            rest[hardware.folding.base] = q[hardware.folding.base]  # the base may stay turned: it carries no weight
        self._rest = rest
        self._move = LandingMove(setpoint, hardware.kp[: hardware.joints])
        self._fold = Fold(hardware, rest, self._move)
        self._sink = Sink(hardware, q, self._move, now)
        self._patience = Patience()
        self._sinks = not hardware.lies_at_rest  # rather than to be let go at once, where it may not lie yet
        self.learns = False
        if np.abs(q - rest).max() < _LIES_RAD:
            self.phase = Phase.LOWER
            self._move.begin(rest, now)
        else:
            self.phase = Phase.FOLD
            self._fold.begin(now)

    @property
    def fade(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Shares (n,) of stiffness with feed-forward, and of damping, while the arm lies or sinks, else None."""
        return (self._sink.shares, self._sink.damping) if self.phase in (Phase.FADE, Phase.SINK) else None

    @property
    def sunk(self) -> np.ndarray:
        """(n,) bool, joints that have lost stiffness while their motors did not answer: nobody knows where they are."""
        return self._sink.sunk

    def advance(self, seen: Seen) -> None:
        """One tick; sets `phase`, `fade`, `learns` and the set-point."""
        self._sink.look(seen)
        if self.phase in (Phase.FOLD, Phase.LOWER):
            self._move.advance(seen.now, seen.usable)
        before, self.phase = self.phase, self._next(seen)
        if before is Phase.FOLD and self.phase is Phase.LOWER:
            self._move.begin(self._rest, seen.now)
        self._sinks = self._sinks or self._fold.gave_up
        self.learns = self.phase in (Phase.FOLD, Phase.OBSTRUCTED) and self._fold.may_learn and seen.explained
        if self.phase in (Phase.FADE, Phase.SINK):
            self._sink.spread(seen, self.phase)

    def _next(self, seen: Seen) -> Phase:
        if self.phase is Phase.FOLD:
            return self._fold.advance(seen)
        if self.phase is Phase.OBSTRUCTED:
            return self._fold.retry(seen.now)
        if self.phase is Phase.LOWER:
            return self._lower(seen)
        if self.phase is Phase.FADE:
            return self._sink.fade(seen)
        return self._sink.sink(seen, self._sinks) if self.phase is Phase.SINK else self.phase

    def _lower(self, seen: Seen) -> Phase:
        """One tick of lowering the wrist; returns the phase that follows."""
        error = np.where(seen.usable, np.abs(self._move.q - seen.q), 0.0).max()
        if not (self._move.arrived or self._patience.ends(error > _CONTACT_RAD, seen.now, _CONTACT_S)):
            return Phase.LOWER
        self._move.give_way(seen.q, seen.usable)
        return Phase.SINK if self._sinks or self._fold.carriers(~seen.usable) else Phase.FADE
