"""The torque that the gravity model misses while an arm holds still: a slow, bounded integral of the position error.

    tau += ki e' dt,  |tau| ≤ limit,  e' = the part of e = q_set − q outside the deadband

It works only while the set-point rests. When the set-point moves, or the arm floats or lands, the torque fades away
(time constant `leak_s`): what was missing in one pose is not what is missing in the next, and a sudden end would be a
knock. While the torque clip acts, or where the error is too large for sag (a hand holds the arm), it does not grow. A
landing has another integral, for arms that hang off their set-point because their model is wrong.

The deadband is what keeps it from hunting: against dry friction an integral without one creeps to and fro for ever.
"""

import numpy as np

# Per Nm/rad of stiffness, so that every joint behaves alike.
_RATE_PER_S = 1.5  # ki / kp: sag shrinks with a time constant of 1 / 1.5 s
_SAG_RAD = 0.05  # most sag that is made up for; YAM's joints 3 and 4 settle about 0.03 rad low
_TOO_FAR_RAD = 0.1
# While an arm lands.
_LAND_RATE_PER_S = 2.0
_LAND_SHARE = 0.4  # of the torque limits: 11 Nm of a DM4340 and 4 of a DM4310: an unknown 3 kg at 0.35 m
_LAND_TOO_FAR_RAD = 0.35  # of a soft wrist; a stiff joint is stuck before


class HoldIntegral:
    """Integral torque of n joints.

    Args:
        ki: (n,) Nm/(rad s).
        limit_nm: (n,) bound of the torque.
        deadband_rad: errors below do not count; several steps of the reading (0.38 mrad).
        leak_s: time constant with which the torque fades.
        too_far_rad: larger errors are not sag.
    """

    def __init__(
        self,
        ki: np.ndarray,
        limit_nm: np.ndarray,
        deadband_rad: float = 0.002,
        leak_s: float = 0.5,
        too_far_rad: float = _TOO_FAR_RAD,
    ):
        self._ki = np.array(ki, dtype=float)
        self._limit = np.array(limit_nm, dtype=float)
        self._deadband, self._leak_s, self._too_far = deadband_rad, leak_s, too_far_rad
        self.tau = np.zeros(len(self._ki))

    @classmethod
    def for_stiffness(cls, kp: np.ndarray) -> "HoldIntegral":
        """With ki and limit in proportion to the position gains kp (n,), Nm/rad."""
        return cls(_RATE_PER_S * np.asarray(kp), _SAG_RAD * np.asarray(kp))

    @classmethod
    def for_landing(cls, kp: np.ndarray, torque_limit_nm: np.ndarray) -> "HoldIntegral":
        """Of an arm that must come down whatever is wrong with its model: quicker, and much stronger, all (n,)."""
        kp = np.maximum(kp, 1.0)
        return cls(_LAND_RATE_PER_S * kp, _LAND_SHARE * torque_limit_nm, too_far_rad=_LAND_TOO_FAR_RAD)

    def advance(self, error: np.ndarray, dt: float, holding: bool, clipped: bool = False) -> np.ndarray:
        """Torque (n,) Nm to feed forward in this tick of `dt` s.

        Args:
            error: (n,) rad, q_set − q.
            holding: the arm holds and its set-point rests.
            clipped: the last commands were held back by the torque clip.
        """
        if not holding:
            self.tau *= max(0.0, 1.0 - dt / self._leak_s)
            return self.tau
        beyond = error - np.minimum(np.maximum(error, -self._deadband), self._deadband)
        step = np.where(np.abs(error) < self._too_far, self._ki * beyond * dt, 0.0)
        if clipped:
            step = np.where(step * self.tau > 0.0, 0.0, step)
        self.tau = np.minimum(np.maximum(self.tau + step, -self._limit), self._limit)
        return self.tau

    def reset(self) -> None:
        """Forget everything at once; for the beginning of a session."""
        self.tau = np.zeros(len(self._ki))
