"""How fast an arm may float: damping beyond the speed of hands, and joints that run away all the same.

    share = (v / limit − 1) / 0.25 within 0 … 1,  kd = idle kd + share (most kd − idle kd)

v is the lesser |dq| of the last two ticks: a hand that takes hold of a light wrist gives it 4 rad/s for one. The share
grows at once and goes back slowly. A wrist is slowed down within one tick: a share that went back as quickly would
let it go and catch it again at every other tick.

Damping alone ends nothing: an arm whose model is wrong goes on to its stops. A joint that needs the damping for longer
than a hand's quick move lasts runs away.
"""

import numpy as np

_FULL = 0.25  # of the limit beyond it: all the damping
_RELEASE_S = 0.1  # in which the share goes back
_RUNS_AWAY_S = 0.25  # at the limit; with 3 rad/s 0.75 rad: a hand's quick moves are shorter, or slower
_FORGET = 0.5  # seconds of that are forgotten in each second below
_ABOUT = 0.9  # of the limit: what is damped there goes on about there


class FloatDamping:
    """Watches the speed of n floating joints. Ask once per tick.

    Args:
        limit_rad_s: below it nothing is damped.
        joints: n.
    """

    def __init__(self, limit_rad_s: float, joints: int):
        self._limit = limit_rad_s
        self._before: np.ndarray = np.zeros(joints)  # |dq| at the last tick
        self._share: np.ndarray = np.zeros(joints)
        self._damped_s: np.ndarray = np.zeros(joints)

    def reset(self) -> None:
        """The arm does not float any more."""
        self._share[:] = self._damped_s[:] = 0.0

    def share(self, dq: np.ndarray, dt: float) -> np.ndarray | None:
        """(n,) of the most damping that each joint needs at `dq` (n,) rad/s, `dt` s after the last tick.

        None: no joint needs any, as nearly always.
        """
        fast = np.abs(dq)
        speed, self._before = np.minimum(fast, self._before), fast
        if speed.max(initial=0.0) <= self._limit and not self._damped_s.any():
            return None
        needed = np.minimum(np.maximum((speed / self._limit - 1.0) / _FULL, 0.0), 1.0)
        self._share = np.maximum(needed, self._share - dt / _RELEASE_S)
        at_limit = speed > np.where(self._damped_s > 0.0, _ABOUT, 1.0) * self._limit
        self._damped_s = np.maximum(self._damped_s + np.where(at_limit, dt, -_FORGET * dt), 0.0)
        return self._share

    @property
    def runs_away(self) -> int | None:
        """The joint that is too fast for longer than any hand, None when no joint is."""
        worst = int(self._damped_s.argmax()) if len(self._damped_s) else 0
        return worst if len(self._damped_s) and self._damped_s[worst] > _RUNS_AWAY_S else None
