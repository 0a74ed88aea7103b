"""Last phases of a landing: stiffness and feed-forward fade until the arm lies, under full damping.

    fade   an arm that lies at its resting pose is let go at once
    sink   any other arm is let down slowly, onto what is below it or to where it hangs

A motor that is not heard may obey. Its set-point is lowered, as its weight pulls by the model, to the end of its range
or to where it hangs; only then does its stiffness fade. Torque may be cut when nothing moves any more.
"""

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.landing.landing_move import LandingMove, Phase, Seen

_FADE_S = 0.15  # time in which stiffness fades where the arm lies
_SINK_S = 1.5  # the same where it does not lie yet, while it is slower than
_SINK_RAD_S = 0.3
_STIFFEN_S = 0.3  # time from no stiffness to all of it, when the arm sinks faster
_LOOSE = 0.1  # share of the damping at last: what slides hardly with all of it would slide on without
_STILL_RAD_S = 0.03  # slower is still
_CREEP_RAD = 0.02  # a joint that has moved by more since it stood still has moved
_STILL_S, _SUNK_S = 0.06, 1.0  # time of standing still after a fade, and after sinking


class Sink:
    """Fade or sink of n joints.

    Attributes:
        shares: (n,) of stiffness and feed-forward of each joint.
    """

    def __init__(self, hardware: ResolvedArm, q: np.ndarray, move: LandingMove, now: float):
        n = hardware.joints
        self._move, self._lower_rad, self._upper_rad = move, hardware.lower[:n], hardware.upper[:n]
        self._share = self._damping = 1.0
        self.shares: np.ndarray = np.ones(n)
        self._heard = self._lowers = np.zeros(n, dtype=bool)  # lowers: with its stiffness, unheard
        self._now, self._dt = now, 0.0
        self._still_since, self._still_q = now, q.copy()

    @property
    def damping(self) -> np.ndarray:
        """(n,) shares of the most damping."""
        return np.where(self._heard, self._damping, 1.0)

    @property
    def sunk(self) -> np.ndarray:
        """(n,) bool, joints that have lost stiffness while their motors did not answer: nobody knows where they are."""
        return ~self._heard & (self.shares < 1.0)

    def look(self, seen: Seen) -> None:
        """Begin a tick, of any phase.

        A motor that does not answer gets no stiffness back: if it obeys, it has left its set-point unseen.
        """
        self._heard, self._dt, self._now = seen.usable, seen.now - self._now, seen.now

    def fade(self, seen: Seen) -> Phase:
        """One tick of an arm that lies; returns the phase that follows."""
        self._share = max(0.0, self._share - self._dt / _FADE_S)
        return Phase.LANDED if self._still(seen, _STILL_S, self._share == 0.0) else Phase.FADE

    def sink(self, seen: Seen, lowers: bool) -> Phase:
        """One tick of an arm that sinks; returns the phase that follows.

        lowers: set-points of joints that are not heard are lowered.
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
        """Give each joint its share for the commands of this tick."""
        fade_s = _FADE_S if phase is Phase.FADE else _SINK_S
        fading = np.where(self._lowers, self.shares, np.maximum(self.shares - self._dt / fade_s, 0.0))
        self.shares = np.where(seen.usable, self._share, fading)

    def _still(self, seen: Seen, still_s: float, loose: bool) -> bool:
        """Whether nothing has moved for so long, with nothing left to hold it."""
        moving = np.abs(np.where(seen.usable, seen.dq, 0.0)).max() > _STILL_RAD_S
        if not loose or moving or np.abs(seen.q - self._still_q).max() > _CREEP_RAD:
            self._still_since, self._still_q = seen.now, seen.q.copy()
            return False
        return seen.now - self._still_since > still_s
