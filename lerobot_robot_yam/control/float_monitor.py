"""Whether an arm may be let float, and whether one that floats runs away: what of it is above the laws, in words."""

import math

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import Hardware
from lerobot_robot_yam.control.impedance import Impedance
from lerobot_robot_yam.control.joint_interface import JointInterface
from lerobot_robot_yam.control.laws.gravity_balance import CHECK, GravityBalance
from lerobot_robot_yam.damiao.tables import motor_type
from lerobot_robot_yam.errors import LifeCycleError

_PATIENCE_S = 2.0  # for a hand that has held the arm up so far to let it go
_AT_STOP_RAD = 0.05  # zeros and stops of real arms are off by a few hundredths


class FloatMonitor:
    """One arm's. Ask `watch` once per tick, then what is to be known.

    Args:
        interface, impedance, hardware: of the arm.
    """

    def __init__(self, interface: JointInterface, impedance: Impedance, hardware: Hardware):
        joints = hardware.motors[: hardware.joints]
        self._interface, self._impedance, self._hardware = interface, impedance, hardware
        self._j = slice(hardware.joints)
        self._names = [motor.name for motor in joints]
        self._balance = GravityBalance(
            self._names, np.array([motor_type(motor.type).torque_max_nm for motor in joints])
        )
        self._now = -math.inf
        self._awaited_since: float | None = None

    def watch(self, now: float, held: bool, afloat: bool) -> str:
        """One tick of an arm that is held, by all its motors, or floats, or neither.

        Returns:
            What runs away, empty when nothing does.
        """
        self._now = now
        dq = self._interface.dq[self._j]
        if held and self._names:
            self._balance.advance(now, self._interface.tau[self._j], self._impedance.weight_nm, dq)
        else:
            self._balance.reset()
        joint = self._impedance.float_speed.runs_away if afloat else None
        if joint is None or not self._impedance.carries(self._interface.q[self._j], joint):  # a shove drives it
            return ""
        return (
            f"{self._names[joint]} goes on at {dq[joint]:.1f} rad/s though it is damped, and is held now; {CHECK}. "
            "If a hand was so fast, raise float_speed_rad_s"
        )

    def settled(self) -> str | None:
        """Why an arm that has just been energised, and holds where it was, does not float; "" when it may.

        None: nobody knows yet, ask again at the next tick. A hand may hold the arm up still, and let go of it soon; one
        that moves it all the time has it.
        """
        if self._awaited_since is None:
            self._awaited_since = self._now
        verdict = self._balance.verdict(self._now) if self._names else ""
        if verdict != "" and self._now - self._awaited_since < _PATIENCE_S:
            return None
        self._awaited_since = None
        return verdict or ""

    def check(self, arm: str) -> None:
        """Refuse to let an arm float that would run away. `arm` for the message.

        A joint at an end of its range may be pressed onto its stop: that weighs nothing.

        Raises:
            LifeCycleError: names joints and torques.
        """
        if not self._names:
            return
        hw, q = self._hardware, self._interface.q[self._j]
        at_stop = (q > hw.upper[self._j] - _AT_STOP_RAD).astype(float) - (q < hw.lower[self._j] + _AT_STOP_RAD)
        wrong = self._balance.verdict(self._now, at_stop)
        if wrong:
            raise LifeCycleError(f"{arm} does not float: {wrong}")
