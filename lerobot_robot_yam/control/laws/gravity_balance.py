"""Comparison of the torque that holds an arm with its gravity model, and how wrong that model may be.

An arm may float if it would stay in place, because friction can supply the residual torque r:

    r = tau − w,  w = gravity model · gravity factor

While the arm floats, the motors produce w, and only friction acts against r. A lying arm needs less torque than w, but
its motors still produce w: r is 0, and the arm may float. If w is too large, motors that hold the arm must pull
downwards, which shows in r.
"""

import math
from collections.abc import Sequence

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.damiao.tables import motor_type
from lerobot_robot_yam.system.few_values import largest

_STILL_RAD_S = 0.15  # maximum speed of an arm at rest
_KNOWN_S = 0.2  # time at rest before torques are used, s: the jerk of the deceleration must fade
_SMOOTH_S = 0.06
_WRONG_SHARE = 0.2  # tolerated error as a share of w: models are 10 to 20 % off (vendor's gravity factors: 1.0 … 1.2)
_WRONG_NM = 0.02  # tolerated error as a share of the motor's range, 0.56 Nm of a DM4340: twice the vendor's friction
CHECK = "check payload_mass_kg, gravity_factor, arm, gripper and base_tilt_rad"


def range_nm(hardware: ResolvedArm) -> np.ndarray:
    """Return the torque ranges (joints,) of the joints' motors, Nm."""
    return np.array([motor_type(motor.type).torque_max_nm for motor in hardware.motors[: hardware.joints]])


def tolerance_nm(range_nm: np.ndarray, weight_nm: np.ndarray) -> np.ndarray:
    """Return by how much (n,) a model may miss the torque that holds joints with weight_nm, both (n,), Nm."""
    tolerance: np.ndarray = _WRONG_NM * range_nm + _WRONG_SHARE * np.abs(weight_nm)
    return tolerance


class GravityBalance:
    """Comparison of n joints' torques with the model. Call `advance` at each tick of a held arm, else `reset`.

    Args:
        names: (n,) joint names, for messages.
        range_nm: (n,) torque ranges of the joints' motors.
    """

    def __init__(self, names: Sequence[str], range_nm: np.ndarray):
        self._names = names
        self._range_nm = np.asarray(range_nm, dtype=float)
        self._still_since = math.inf
        self._before = -math.inf
        self._wrong: np.ndarray = np.zeros(len(self._names))
        self._weight: np.ndarray = np.zeros(len(self._names))
        self._known_until = -math.inf

    @property
    def wrong_nm(self) -> np.ndarray:
        """Difference (n,) of the torque of the joints at rest from the model's, Nm."""
        return self._wrong

    def reset(self) -> None:
        """Forget all torques because the arm is not held by all its motors."""
        self._still_since, self._known_until = math.inf, -math.inf

    def advance(self, now: float, tau_nm: np.ndarray, weight_nm: np.ndarray, dq: np.ndarray) -> None:
        """Process one tick of a held arm.

        Args:
            now: time, s.
            tau_nm, weight_nm: (n,) measured torque, and modelled gravity torque w.
            dq: (n,) speed, rad/s.
        """
        dt, self._before = now - self._before, now
        if largest(dq) > _STILL_RAD_S:
            if now - self._still_since > _KNOWN_S:
                self._known_until = now
            self._still_since = math.inf
            return
        if self._still_since == math.inf:
            self._still_since = now
            self._wrong = tau_nm - weight_nm
        self._wrong += (tau_nm - weight_nm - self._wrong) * min(dt / _SMOOTH_S, 1.0)
        self._weight = weight_nm

    def verdict(self, now: float, unknown: np.ndarray | None = None, memory_s: float = 0.0) -> str | None:
        """Return a message naming the joints that would run away; "" if the arm may float, None while unknown.

        Args:
            now: time, s.
            unknown: (n,) direction in which a stop may hold the joint, else 0; torque in this direction is ignored.
            memory_s: maximum age of torques from before a motion that may be used for a moving arm, s.
        """
        if not now - self._still_since > _KNOWN_S and now - self._known_until >= memory_s:
            return None
        wrong, weight = self._wrong, self._weight
        if unknown is not None:
            wrong = np.where(wrong * unknown > 0.0, 0.0, wrong)
        beyond = np.abs(wrong) - tolerance_nm(self._range_nm, weight)
        worst = int(beyond.argmax())
        if beyond[worst] <= 0.0:
            return ""
        parts = [
            f"{self._names[i]} is held with {weight[i] + wrong[i]:.1f} Nm where the model says {weight[i]:.1f}"
            for i in np.flatnonzero(beyond > 0.0)
        ]
        return f"{', '.join(parts)}, and would run away; {CHECK}, and let go of the arm"
