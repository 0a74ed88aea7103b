"""Position and speed of an arm that a hand moves, without the steps of its encoders and hardly later than they say.

    q̂ += dq̂ Δt + α (q − q̂ − dq̂ Δt),   dq̂ += β (dq − dq̂)

A motor tells its position in steps of 0.38 mrad and its speed in steps of 5 to 15 mrad/s. A follower that is sent the
steps answers each with a jerk. A position that is carried on with the speed has no lag while the speed is steady.
"""

import numpy as np

_ALPHA, _BETA = 0.2, 0.3  # per tick of 250 Hz
_TICK_S = 0.004
_RESTART_S = 0.05  # after a longer pause it begins anew


class MotionFilter:
    """Of n joints.

    Attributes:
        q, dq: (n,) rad, rad/s at `stamp_s`.
    """

    def __init__(self, joints: int):
        self.q: np.ndarray = np.zeros(joints)
        self.dq: np.ndarray = np.zeros(joints)
        self.stamp_s = -np.inf

    def advance(self, q: np.ndarray, dq: np.ndarray, stamp_s: float) -> None:
        """Take a sample (n,) of that time; one that is not newer is passed over."""
        dt = stamp_s - self.stamp_s
        if dt <= 0.0:
            return
        self.stamp_s = stamp_s
        if dt > _RESTART_S:
            self.q, self.dq = q.copy(), dq.copy()
            return
        ticks = dt / _TICK_S
        ahead = self.q + self.dq * dt
        self.q = ahead + (1.0 - (1.0 - _ALPHA) ** ticks) * (q - ahead)
        self.dq = self.dq + (1.0 - (1.0 - _BETA) ** ticks) * (dq - self.dq)
