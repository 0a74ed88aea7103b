"""Force feedback for one leader, (n,) per joint: the leader is pulled towards a follower that is held back.

    tau = s · clip(k e, ±bound),   e = q_follower − q_leader,   k = gain · kp
    added damping: c = k T,  T = 12 ms + measured delay beyond 20 ms,  gain ≤ 0.5 · 12 ms / T

A spring that acts late by T stays passive if k T < damping (Colgate and Schenkel, "Passivity of a class of sampled-data
systems", 1997; with delay Gil et al., "Stability boundary for haptic rendering", 2009). So c follows the delay, and the
gain is reduced where c would exceed its value for the largest gain without delay: a leader must stay light.

The share s gates the force by the operator's reaction. s is 1 while the operator moves against the force, pushes or
holds still, and fades as the leader yields to the force:

    ẏ = dq · sat(e / 5 mrad) − leak,   −credit ≤ y ≤ Y,   s = clip(2 (Y − y) / Y, 0, 1)

y is the distance by which the force has moved the leader; moving the leader against a significant force reduces y.
Without the share s, a leader that nobody holds follows the sag of its follower, which follows the leader: both arms
drift away at full speed. With the share s both arms stop after a distance of Y.

The energy W that the spring gives a leader is taken back by damping b, so that a leader let go under load does not
snap. A leader that is pushed, or held still, feels the spring alone. This is the passivity observer W and the passivity
controller b of Hannaford and Ryu, "Time-domain passivity control of haptic interfaces", 2002, for a reference of zero:

    Ẇ = tau dq − b dq² − W / 0.3 s,   W ≥ 0,   b = min(W / (dq² · 10 ms), 4 Nm s/rad)
"""

import numpy as np

from lerobot_robot_yam.arm.leaders.lead_config import GAIN_MOST

LAG_S = 0.012  # T with quick adapters: delay by sampling, CAN frames and ticks, s
_QUICK_S = 0.02  # measured delay up to which T is `LAG_S`, s: two loops out of step read each other up to a tick late
_ADAPTS_S = 0.2  # time constant with which T follows the measured delay, s
_GIVES_WAY_RAD = 0.1  # Y, distance yielded by the leader after which the force is zero
_CREDIT_RAD = 0.3  # maximum credit, earned by moving the leader against the force
_WORTH_RAD = 0.03  # error e from which a force counts as significant: more than a freely moving follower lags
_SIGN_RAD = 0.005
_LEAK_RAD_S = 0.005
_CREDIT_S = 2.0  # time constant with which unused credit decays
_BOUND_SHARE = 0.25  # maximum force, as a share of the torque limit
_TAKEN_BACK_S = 0.01  # time in which the damping b takes the energy W back, s
_FORGOTTEN_S = 0.3  # time constant with which W decays, s: a hand may have taken that energy
_BACK_MOST = 4.0  # maximum b, Nm s/rad: with the other damping of a leader below the 5 that motors accept
_BACK_S_RAD = 0.15  # the same as a share of the torque limit, s/rad: a light wrist whose speed is filtered would swing
_FADE_S = 0.5
_GENTLE_NM = 1.0  # minimum growth of the bound per `_FADE_S`, Nm


class BilateralForce:
    """Force feedback for one leader.

    Args:
        gain: (n,) spring stiffness, as a share of kp.
        kp: (n,) the leader's position gains, Nm/rad.
        torque_limit_nm: (n,) torque limits of the leader.
        gated: whether the share s and the damping b act; False, a plain spring, only for comparisons.

    Attributes:
        works: whether the gain of any joint is not zero.
        lag_s: present T, s.
        damping: (n,) c + b for the torque computed last, Nm s/rad.
    """

    def __init__(self, gain: np.ndarray, kp: np.ndarray, torque_limit_nm: np.ndarray, gated: bool = True):
        self.gain, self._kp, self.lag_s = gain, kp, LAG_S
        self.stiffness = gain * kp
        self._steady = LAG_S * self.stiffness  # c
        self._bound, self._gated = _BOUND_SHARE * torque_limit_nm, gated
        self._back_most = np.minimum(_BACK_S_RAD * torque_limit_nm, _BACK_MOST)
        self.works = bool(self.stiffness.any())
        self._ceiling: np.ndarray = np.zeros(len(gain))  # present bound, which grows to `_bound`
        self._given_way = [0.0] * len(gain)  # y
        self._given_j: np.ndarray = np.zeros(len(gain))  # W
        self.damping = self._steady

    @property
    def gain_most(self) -> float:
        """Maximum gain for the present delay."""
        return GAIN_MOST * LAG_S / self.lag_s

    def adapt(self, delay_s: float, dt: float) -> bool:
        """Adapt gain and damping to the measured delay; return whether T has reached the delay within a tenth."""
        lag_s = LAG_S + max(delay_s - _QUICK_S, 0.0)
        self.lag_s += (lag_s - self.lag_s) * dt / _ADAPTS_S
        back = self.damping - self._steady
        self.stiffness = np.minimum(self.gain, self.gain_most) * self._kp
        self._steady = self.lag_s * self.stiffness
        self.damping = self._steady + back
        return abs(lag_s - self.lag_s) < 0.1 * lag_s

    def engage(self, start_nm: np.ndarray | None = None) -> None:
        """Start with a force of at most `start_nm` (n,), by default zero."""
        self._ceiling = np.zeros(len(self._given_way)) if start_nm is None else np.abs(start_nm)
        self._given_way = [0.0] * len(self._given_way)
        self._given_j = np.zeros(len(self._given_j))
        self.damping = self._steady

    def torque(self, error: np.ndarray, dq: np.ndarray, weight_nm: np.ndarray, dt: float) -> np.ndarray:
        """Compute the torque (n,), Nm, for one tick of `dt` s.

        Args:
            error: (n,) e, rad.
            dq: (n,) leader's speed, rad/s.
            weight_nm: (n,) gravity torque on the leader. After `engage` the bound grows; per `_FADE_S` the
                growth is half of this torque, but at least `_GENTLE_NM`.
        """
        gentle = np.maximum(_GENTLE_NM, 0.5 * np.abs(weight_nm))
        bound = self._ceiling
        self._ceiling = np.minimum(self._bound, bound + gentle * (dt / _FADE_S))
        spring: np.ndarray = np.minimum(np.maximum(self.stiffness * error, -bound), bound)
        if not self._gated:
            return spring
        moved = zip(self._given_way, error.tolist(), (dq * dt).tolist(), strict=True)
        self._given_way = [_given_way(y, e, way, dt) for y, e, way in moved]
        share = [min(2.0 * (_GIVES_WAY_RAD - y) / _GIVES_WAY_RAD, 1.0) for y in self._given_way]
        return self._take_back(spring * share, dq, dt)

    def _take_back(self, tau: np.ndarray, dq: np.ndarray, dt: float) -> np.ndarray:
        """Set the damping that takes back the energy which the torque (n,) gives; return the torque."""
        back = self.damping - self._steady
        given = (self._given_j + (tau - back * dq) * dq * dt) * (1.0 - dt / _FORGOTTEN_S)
        self._given_j = given = np.maximum(given, 0.0)
        self.damping = self._steady + np.minimum(given / np.maximum(dq * dq * _TAKEN_BACK_S, 1e-9), self._back_most)
        return tau


def _given_way(y: float, error: float, way: float, dt: float) -> float:
    """Return y of one joint after a tick in which the leader moved by `way` rad. Plain floats are faster than numpy."""
    along = way * min(max(error / _SIGN_RAD, -1.0), 1.0)
    if along > 0.0 or y > 0.0 or abs(error) > _WORTH_RAD:
        y += along
    y = max(y - _LEAK_RAD_S * dt, 0.0) if y > 0.0 else y * (1.0 - dt / _CREDIT_S)
    return min(max(y, -_CREDIT_RAD), _GIVES_WAY_RAD)
