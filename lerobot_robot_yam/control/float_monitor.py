"""Checks whether an arm may float, and whether a floating arm runs away.

An arm may float if it would stay where it is, because the torque r that holds it beyond its model's is friction:

    r = tau − w,  w = gravity model · gravity factor

While floating, the motors give w and nothing holds the arm against r any more, but friction. An arm that lies needs
less torque than w, but its motors give w all the same: r is 0, and the arm may float. Where w is too much, motors that
hold the arm must pull it down, and r shows that.
"""

import math
from collections.abc import Sequence

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.impedance import Impedance
from lerobot_robot_yam.control.joints.estimate import JointEstimate
from lerobot_robot_yam.damiao.tables import motor_type
from lerobot_robot_yam.errors import LifeCycleError
from lerobot_robot_yam.system.few_values import largest

_PATIENCE_S = 2.0  # longest wait for a hand that holds the arm up to let go, s
_AT_STOP_RAD = 0.05  # distance from a limit that counts as its stop: zeros of real arms are off by a few hundredths
_STILL_RAD_S = 0.15
_KNOWN_S = 0.2  # time of standing still before torques count, s: the jerk of coming to rest fades
_MEMORY_S = 1.0  # how long torques from before a motion count, s: a joint that slips for a moment proves nothing
_SMOOTH_S = 0.06
_WRONG_SHARE = 0.2  # share of w that may be wrong: models are 10 to 20 % off (vendor's gravity factors: 1.0 … 1.2)
_WRONG_NM = 0.02  # share of the motor's range that may be wrong, 0.56 Nm of a DM4340: twice the vendor's friction
CHECK = "check payload_mass_kg, gravity_factor, arm, gripper and base_tilt_rad"


class GravityBalance:
    """Comparison of n joints' torques with the model. Advance once per tick while the arm is held, `reset` when not.

    Args:
        names: (n,) names of the joints, for messages.
        range_nm: (n,) torque range of the joints' motors.
    """

    def __init__(self, names: Sequence[str], range_nm: np.ndarray):
        self._names = names
        self._least = _WRONG_NM * np.asarray(range_nm, dtype=float)
        self._still_since = math.inf
        self._before = -math.inf
        self._wrong: np.ndarray = np.zeros(len(self._names))
        self._weight: np.ndarray = np.zeros(len(self._names))
        self._known_until = -math.inf

    def reset(self) -> None:
        """Forget all torques: the arm is not held any more, or not by all its motors."""
        self._still_since, self._known_until = math.inf, -math.inf

    def advance(self, now: float, tau_nm: np.ndarray, weight_nm: np.ndarray, dq: np.ndarray) -> None:
        """Process one tick of an arm that is held.

        Args:
            now: s.
            tau_nm, weight_nm: (n,) measured torque, and the model's torque w.
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
        """Return a message that names the joints that would run away; "" if the arm may float, None while unknown.

        Args:
            now: s.
            unknown: (n,) direction in which a stop may hold the joint, else 0; torque that way is not judged.
            memory_s: time for which a moving arm is judged by its torques from before the motion, s.
        """
        if not now - self._still_since > _KNOWN_S and now - self._known_until >= memory_s:
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


class FloatMonitor:
    """Monitor of one arm. Call `watch` once per tick, before the other methods."""

    def __init__(self, estimate: JointEstimate, impedance: Impedance, hardware: ResolvedArm):
        self._estimate, self._impedance, self._hardware = estimate, impedance, hardware
        self._j, self._names = slice(hardware.joints), hardware.joint_names
        ranges = [motor_type(motor.type).torque_max_nm for motor in hardware.motors[self._j]]
        self._balance = GravityBalance(self._names, np.array(ranges))
        self._now = -math.inf
        self._awaited_since: float | None = None

    def watch(self, now: float, held: bool, afloat: bool) -> str:
        """Process one tick of an arm that is `held` by all its motors, or `afloat`, or neither.

        Returns:
            A message that names the joint that runs away; empty when none does.
        """
        self._now = now
        dq = self._estimate.dq[self._j]
        if held and self._names:
            self._balance.advance(now, self._estimate.tau[self._j], self._impedance.weight_nm, dq)
        else:
            self._balance.reset()
        joint = self._impedance.float_speed.runs_away if afloat else None
        # A joint that carries no weight can only have been moved by a shove.
        if joint is None or not self._impedance.carries(self._estimate.q[self._j], joint):
            return ""
        return (
            f"{self._names[joint]} goes on at {dq[joint]:.1f} rad/s though it is damped, and is held now; {CHECK}. "
            "If a hand was so fast, raise float_speed_rad_s"
        )

    def settled(self) -> str | None:
        """Return why a just energised arm that holds its pose may not float; "" when it may, None while unknown.

        After None ask again at the next tick: a hand may still hold the arm up, and let go soon. An arm that a hand
        moves all the time may float, since the hand holds it.
        """
        if self._awaited_since is None:
            self._awaited_since = self._now
        verdict = self._balance.verdict(self._now) if self._names else ""
        if verdict != "" and self._now - self._awaited_since < _PATIENCE_S:
            return None
        self._awaited_since = None
        return verdict or ""

    def check(self, arm: str) -> None:
        """Refuse to let an arm float that would run away. `arm`: its name, for the message.

        Torque that presses a joint onto the stop at an end of its range does not count.

        Raises:
            LifeCycleError: joints would run away; the message names joints and torques.
        """
        if not self._names:
            return
        hw, q = self._hardware, self._estimate.q[self._j]
        at_stop = (q > hw.upper[self._j] - _AT_STOP_RAD).astype(float) - (q < hw.lower[self._j] + _AT_STOP_RAD)
        wrong = self._balance.verdict(self._now, at_stop, _MEMORY_S)
        if wrong:
            raise LifeCycleError(f"{arm} does not float: {wrong}")
