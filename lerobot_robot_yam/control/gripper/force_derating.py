"""How much of its force a gripper may use: less once it has pressed on something for a while, less as its motor warms.

A gripper that keeps squeezing an object turns all its power into heat (the DM3507's rated torque, 0.8 Nm, is below the
1.03 Nm of a 50 N squeeze), while holding what has been gripped takes much less than gripping it.

    stalled   pressing one way, standing still, for a second
    share     goes from 1 to HOLD_SHARE within half a second of the stall, back to 1 when the command lets go
    derating  1 at level 0 of `heat`, 0.3 at the trip; the smaller of the two factors counts
"""

import math

HOLD_SHARE = 0.5
_STALL_S = 1.0
_EASE_S = 0.5
_STILL_PER_S = 0.05  # strokes/s
_PRESSING_NM = 0.5  # where the maker's limiter begins to act
_SMOOTH_S = 0.1  # of the torque: single readings are noisy
_LOST_STROKES = 0.05  # what is gripped gives way by less than this
_GAP_S = 0.2  # not asked for so long: the gripper did something else meanwhile
_TRIP_SHARE = 0.3


class GripForce:
    """One gripper's allowance. Ask once per tick.

    Attributes:
        stalled: it presses on something that does not give way.
        opening: the way it presses while it is stalled: True outwards.
        press_nm: how hard it pressed when the stall was noticed.
    """

    def __init__(self) -> None:
        self.stalled = False
        self.opening = False
        self.press_nm = 0.0
        self._share = 1.0
        self._derating = 1.0
        self._effort = 0.0
        self._place = 0.0
        self._since = math.inf
        self._last = -math.inf

    @property
    def factor(self) -> float:
        """Share of the configured force, 0 … 1."""
        return min(self._share, self._derating)

    def derate(self, level: float) -> None:
        """Take the motor's heat level, 0 … 1, into account."""
        self._derating = 1.0 - (1.0 - _TRIP_SHARE) * min(max(level, 0.0), 1.0)

    def update(self, now: float, u_set: float, u: float, rate: float, tau_nm: float) -> bool:
        """One tick.

        Args:
            now: s.
            u_set, u: where the gripper is asked to be and is, 0 closed … 1 open.
            rate: strokes/s.
            tau_nm: measured motor torque towards open.

        Returns:
            True on the tick on which a stall is noticed.
        """
        dt = now - self._last
        self._last = now
        opening = u_set > u
        press = tau_nm if opening else -tau_nm
        if dt > _GAP_S or opening is not self.opening:
            self._let_go(opening)
            self._effort = press
            return False
        self._effort += (press - self._effort) * min(dt / _SMOOTH_S, 1.0)
        if self.stalled:
            gone = u - self._place if opening else self._place - u
            if gone > _LOST_STROKES:
                self._let_go(opening)
            else:
                self._share = max(HOLD_SHARE, self._share - (1.0 - HOLD_SHARE) / _EASE_S * dt)
            return False
        if abs(rate) > _STILL_PER_S or self._effort < _PRESSING_NM * self._derating:
            self._since = math.inf
            return False
        self._since = min(self._since, now)
        self.stalled = now - self._since > _STALL_S
        if self.stalled:
            self.press_nm, self._place = self._effort, u
        return self.stalled

    def _let_go(self, opening: bool) -> None:
        self.opening, self.stalled, self._share, self._since = opening, False, 1.0, math.inf
