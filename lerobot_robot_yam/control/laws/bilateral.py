"""Force feedback of one leader: what its follower is held back by pulls at the leader, (n,) per joint.

    tau = s · clip(k e, ±bound),   e = q_follower − q_leader,   k = gain · kp
    added damping: c = k T,  T = 12 ms: more than the spring loses to samples, frames and ticks

The share s keeps the force from moving a leader that nobody holds. A tank counts the energy that the operator has put
in by moving against the spring, and what the force has given back by moving the leader; an empty one gives nothing:

    Ė = −(k e) · dq  where the operator works,   Ė = −tau · dq  where the force does
    0 ≤ E ≤ E_most,   s = min(1, E / E₀)

So a hand that holds still, pushes or moves feels all of it, and a leader let go comes to rest, wherever its follower
sags. A small inflow lets a hand that holds still feel a push on the follower, again and again.
"""

import numpy as np

LAG_S = 0.012  # T
_FULL_J = 0.01  # E₀
_MOST_J = 0.5
_INFLOW_W = 0.004
_BOUND_SHARE = 0.25  # of the torque limit
_FADE_S = 0.5  # after engaging
_GENTLE_NM = 1.0


class BilateralForce:
    """Of one leader.

    Args:
        gain: (n,) share of kp.
        kp: (n,) the leader's position gains, Nm/rad.
        torque_limit_nm: (n,) of the leader.
        gated: False: all of the force, whoever moves; for comparisons.
    """

    def __init__(self, gain: np.ndarray, kp: np.ndarray, torque_limit_nm: np.ndarray, gated: bool = True):
        self.stiffness = gain * kp
        self.damping = LAG_S * self.stiffness
        self._bound, self._gated = _BOUND_SHARE * torque_limit_nm, gated
        self._since_s = 0.0
        self._tank: np.ndarray = np.full(len(gain), _FULL_J)

    @property
    def works(self) -> bool:
        """Whether any joint has a gain."""
        return bool(self.stiffness.any())

    def engage(self) -> None:
        """Begin: the follower has just caught up."""
        self._since_s = 0.0
        self._tank[:] = _FULL_J

    def torque(self, error: np.ndarray, dq: np.ndarray, weight_nm: np.ndarray, dt: float) -> np.ndarray:
        """(n,) Nm at this tick of `dt` s.

        Args:
            error: (n,) rad, e.
            dq: (n,) rad/s, of the leader.
            weight_nm: (n,) what the leader weighs: within `_FADE_S` of engaging the force grows from zero, and to half
                of that or 1 Nm at most.
        """
        bound = self._bound
        if self._since_s < _FADE_S:
            gentle = np.maximum(_GENTLE_NM, 0.5 * np.abs(weight_nm))
            bound = np.minimum(bound, gentle * (self._since_s / _FADE_S))
        self._since_s += dt
        spring = np.minimum(np.maximum(self.stiffness * error, -bound), bound)
        if not self._gated:
            return spring
        tau = spring * np.minimum(self._tank / _FULL_J, 1.0)
        power = spring * dq
        flow = np.where(power < 0.0, -power, -tau * dq) + _INFLOW_W
        self._tank = np.minimum(np.maximum(self._tank + flow * dt, 0.0), _MOST_J)
        return tau
