"""Whether an arm that is held would stay if it were let float: the torque that holds it against that of its model.

    r = tau − w,  w = gravity model · gravity factor

While floating, the motors give w and nothing holds the arm against r any more. Friction does: what it carries is in r
no more than it will be then. An arm that lies needs less than its model says, but it is not pressed down either: its
motors give w, r is 0, and it may float. Where w is too much they must pull it down, and r shows it.
"""

import math
from collections.abc import Sequence

import numpy as np

_STILL_RAD_S = 0.15
_KNOWN_S = 0.2  # of standing still: what is left of the jerk of coming to rest
_SMOOTH_S = 0.06
_WRONG_SHARE = 0.2  # of w; real arms are 10 to 20 % off their models (vendor's gravity factors: 1.0 … 1.2)
_WRONG_NM = 0.02  # of the motor's range, 0.56 Nm of a DM4340: twice the friction that the vendor compensates
CHECK = "check payload_mass_kg, gravity_factor, arm, gripper and base_tilt_rad"


class GravityBalance:
    """Compares the torques of n joints. Ask once per tick while the arm is held, `reset` when it is not.

    Args:
        names: of the joints.
        range_nm: (n,) torque range of their motors.
    """

    def __init__(self, names: Sequence[str], range_nm: np.ndarray):
        self._names = tuple(names)
        self._least = _WRONG_NM * np.asarray(range_nm, dtype=float)
        self._still_since = math.inf
        self._before = -math.inf
        self._wrong: np.ndarray = np.zeros(len(self._names))
        self._weight: np.ndarray = np.zeros(len(self._names))

    def reset(self) -> None:
        """The arm is not held any more, or not by all its motors."""
        self._still_since = math.inf

    def advance(self, now: float, tau_nm: np.ndarray, weight_nm: np.ndarray, dq: np.ndarray) -> None:
        """One tick of an arm that is held.

        Args:
            now: s.
            tau_nm, weight_nm: (n,) measured torque, and w.
            dq: (n,) rad/s.
        """
        dt, self._before = now - self._before, now
        if np.abs(dq).max(initial=0.0) > _STILL_RAD_S:
            self._still_since = math.inf
            return
        if self._still_since == math.inf:
            self._still_since = now
            self._wrong = tau_nm - weight_nm
        self._wrong += (tau_nm - weight_nm - self._wrong) * min(dt / _SMOOTH_S, 1.0)
        self._weight = weight_nm

    def verdict(self, now: float, unknown: np.ndarray | None = None) -> str | None:
        """What would make the arm run away; "" when nothing would, None while nobody knows.

        Args:
            now: s.
            unknown: (n,) rad, direction in which a stop may hold the joint, 0 where none does: not judged.
        """
        if not now - self._still_since > _KNOWN_S:
            return None
        wrong, weight = self._wrong, self._weight
        if unknown is not None:
            wrong = np.where(wrong * unknown > 0.0, 0.0, wrong)
        beyond = np.abs(wrong) - self._least - _WRONG_SHARE * np.abs(weight)
        worst = int(beyond.argmax())
        if beyond[worst] <= 0.0:
            return ""
        parts = [
            f"{self._names[i]} is held with {weight[i] + wrong[i]:.1f} Nm where the model says {weight[i]:.1f}"
            for i in np.flatnonzero(beyond > 0.0)
        ]
        return f"{', '.join(parts)}, and would run away; {CHECK}, and let go of the arm"
