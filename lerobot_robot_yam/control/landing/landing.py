"""Landing: move the arm under control to a pose in which cutting torque causes no motion.

    fold    move to the folded pose with the wrist raised; an arm that lies already stays (`Fold`)
    lower   lower the wrist to its resting place, stopping at contact
    fade    or sink: reduce stiffness and feedforward to zero; unsupported parts sink slowly (`Sink`)

An arm without one of its supporting motors may never reach the folded pose, since a limp wrist blocks the path. Such an
arm sinks onto the obstacle that stopped its descent. The arm also sinks instead of fading if a supporting motor is limp
or silent at the end of `lower`, since the position of that motor's joint is then unknown.

An arm with a tilted base or a configured resting pose is not supported in its resting pose. From that pose, such an arm
sinks until each part hangs freely or lies on something; torque is cut once nothing moves.

A silent motor may still obey. Its set-point is lowered in the direction of the modelled gravity torque, to the end of
the range or to the hanging position of the joint; only then does the stiffness fade.
"""

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.landing.fold import Fold
from lerobot_robot_yam.control.landing.landing_move import LandingMove, Patience, Phase, Seen
from lerobot_robot_yam.control.laws.set_point import SetPoint

_LIES_RAD = 0.06  # maximum distance from the resting pose of an arm that lies already
_CONTACT_RAD, _CONTACT_S = 0.12, 0.1  # error, rad, and its minimum duration, s, that indicate contact while lowering
_FADE_S = 0.15  # time in which stiffness fades if the arm lies, s
_SINK_S = 1.5  # time in which stiffness fades if the arm does not lie yet, s
_SINK_RAD_S = 0.3  # speed at or above which a sinking arm stiffens
_STIFFEN_S = 0.3  # time from zero to full stiffness if the arm sinks too fast, s
_LOOSE = 0.1  # minimum share of damping: with more damping a slide might be too slow to be detected
_STILL_RAD_S = 0.03  # maximum speed of an arm at rest
_CREEP_RAD = 0.02  # displacement above which a joint at rest counts as moving
_STILL_S, _SUNK_S = 0.06, 1.0  # time at rest, s, after which a fade ends, and after which sinking ends


class Sink:
    """Fading or sinking of n joints.

    Attributes:
        shares: (n,) remaining shares of stiffness and feedforward.
    """

    def __init__(self, hardware: ResolvedArm, q: np.ndarray, move: LandingMove, now: float):
        n = hardware.joints
        self._move, self._lower_rad, self._upper_rad = move, hardware.lower[:n], hardware.upper[:n]
        self._share = self._damping = 1.0
        self.shares: np.ndarray = np.ones(n)
        self._heard = self._lowers = np.zeros(n, dtype=bool)  # lowers: silent joints with sinking set-points
        self._now, self._dt = now, 0.0
        self._still_since, self._still_q = now, q.copy()

    @property
    def damping(self) -> np.ndarray:
        """Shares (n,) of the maximum damping."""
        return np.where(self._heard, self._damping, 1.0)

    @property
    def sunk(self) -> np.ndarray:
        """(n,) bool, joints that have lost stiffness while their motors were silent, so that they may have sunk."""
        return ~self._heard & (self.shares < 1.0)

    def look(self, seen: Seen) -> None:
        """Store the inputs of a tick in any phase.

        A silent motor gets no stiffness back: if the motor obeys, its joint has left the set-point undetected.
        """
        self._heard, self._dt, self._now = seen.usable, seen.now - self._now, seen.now

    def fade(self, seen: Seen) -> Phase:
        """Advance the fade of a lying arm by one tick; return the next phase."""
        self._share = max(0.0, self._share - self._dt / _FADE_S)
        return Phase.LANDED if self._still(seen, _STILL_S, self._share == 0.0) else Phase.FADE

    def sink(self, seen: Seen, lowers: bool) -> Phase:
        """Advance a sinking arm by one tick; return the next phase.

        lowers: whether the set-points of joints with silent motors are lowered.
        """
        move, usable, most = self._move, seen.usable, _SINK_RAD_S * self._dt
        before = move.q.copy()
        move.give_way(move.near(np.clip(seen.q, before - most, before + most), seen.q), usable)
        lowered = before + most * seen.pulls
        inside = (lowered >= self._lower_rad) & (lowered <= self._upper_rad)
        self._lowers = inside & (lowered != before) & (self.shares > 0.0) & ~usable & lowers
        move.give_way(lowered, self._lowers)
        if not np.abs(np.where(usable, seen.dq, 0.0)).max() < _SINK_RAD_S:
            self._share, self._damping = min(self._share + self._dt / _STIFFEN_S, 1.0), 1.0
        elif self._share > 0.0:
            self._share = max(self._share - self._dt / _SINK_S, 0.0)
        else:
            self._damping = max(self._damping - self._dt / _SINK_S, _LOOSE)
        loose = self._share == 0.0 and self._damping == _LOOSE and not self.shares[~usable].any()
        return Phase.LANDED if self._still(seen, _SUNK_S, loose) else Phase.SINK

    def spread(self, seen: Seen, phase: Phase) -> None:
        """Compute `shares` for the commands of this tick."""
        fade_s = _FADE_S if phase is Phase.FADE else _SINK_S
        fading = np.where(self._lowers, self.shares, np.maximum(self.shares - self._dt / fade_s, 0.0))
        self.shares = np.where(seen.usable, self._share, fading)

    def _still(self, seen: Seen, still_s: float, loose: bool) -> bool:
        """Return whether the arm has been at rest for `still_s`. loose: whether nothing holds the arm any more."""
        moving = np.abs(np.where(seen.usable, seen.dq, 0.0)).max() > _STILL_RAD_S
        if not loose or moving or np.abs(seen.q - self._still_q).max() > _CREEP_RAD:
            self._still_since, self._still_q = seen.now, seen.q.copy()
            return False
        return seen.now - self._still_since > still_s


class Landing:
    """Landing of the arm joints (n,).

    Args:
        hardware: the arm. An arm that is not supported in its resting pose sinks from that pose.
        q: (n,) measured positions, rad.
        setpoint: the arm's set-point; its limits are lowered and not restored.
        now: monotonic time, s.

    Attributes:
        phase: the present phase.
        learns: whether the arm learns a torque that corrects its gravity model.
    """

    def __init__(self, hardware: ResolvedArm, q: np.ndarray, setpoint: SetPoint, now: float):
        rest = hardware.rest_q.copy()
        if hardware.folding.base is not None and hardware.lies_at_rest:
            rest[hardware.folding.base] = q[hardware.folding.base]  # the base may stay turned: it supports no weight
        self._rest = rest
        self._move = LandingMove(setpoint, hardware.kp[: hardware.joints])
        self._fold = Fold(hardware, rest, self._move)
        self._sink = Sink(hardware, q, self._move, now)
        self._patience = Patience()
        self._sinks = not hardware.lies_at_rest  # sink rather than fade, since the arm may not lie yet
        self.learns = False
        if np.abs(q - rest).max() < _LIES_RAD:
            self.phase = Phase.LOWER
            self._move.begin(rest, now)
        else:
            self.phase = Phase.FOLD
            self._fold.begin(now)

    @property
    def fade(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Shares (n,) of stiffness and feedforward, and of damping, in phases FADE and SINK; None in others."""
        return (self._sink.shares, self._sink.damping) if self.phase in (Phase.FADE, Phase.SINK) else None

    @property
    def sunk(self) -> np.ndarray:
        """(n,) bool, joints that have lost stiffness while their motors were silent, so that they may have sunk."""
        return self._sink.sunk

    def advance(self, seen: Seen) -> None:
        """Advance by one tick; update `phase`, `fade`, `learns` and the set-point."""
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
        """Advance the lowering of the wrist by one tick; return the next phase."""
        error = np.where(seen.usable, np.abs(self._move.q - seen.q), 0.0).max()
        if not (self._move.arrived or self._patience.ends(error > _CONTACT_RAD, seen.now, _CONTACT_S)):
            return Phase.LOWER
        self._move.give_way(seen.q, seen.usable)
        return Phase.SINK if self._sinks or self._fold.carriers(~seen.usable) else Phase.FADE
