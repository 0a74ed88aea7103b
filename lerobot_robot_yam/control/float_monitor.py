"""Checks whether an arm may float, whether a floating arm runs away, and whether a hand made it fast."""

import logging
import math
from collections.abc import Callable

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.actuation import Actuation
from lerobot_robot_yam.control.impedance import Impedance
from lerobot_robot_yam.control.joints.estimate import JointEstimate
from lerobot_robot_yam.control.laws.gravity_balance import CHECK, GravityBalance, range_nm
from lerobot_robot_yam.control.laws.mit_laws import FELT_SHARE
from lerobot_robot_yam.errors import LifeCycleError
from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.state.modes import Mode

logger = logging.getLogger(__name__)

_PATIENCE_S = 2.0  # maximum wait for a hand that supports the arm to be removed, s
_AT_STOP_RAD = 0.05  # distance to a joint limit that counts as its stop: real zeros are off by a few hundredths
_MEMORY_S = 1.0  # maximum age of torques from before a motion, s: a brief slip of a joint proves nothing
_WEIGHT_S = 1.0  # time for which the torque of an arm that nobody touches is the same, s: no hand is so steady
_VARIES = 0.01  # variation of a hand's torque, as a share of the joint's torque limit: 0.1 Nm at a wrist
_GRIPPED = 0.1  # squeeze of the trigger that shows a hand at the handle
_SOON_S = 5.0  # time after a pause in which another one counts as the second, s


class FloatMonitor:
    """Float monitor for one arm. Call `watch` once per tick, before the other methods."""

    def __init__(self, estimate: JointEstimate, impedance: Impedance, hardware: ResolvedArm):
        self._estimate, self._impedance, self._hardware = estimate, impedance, hardware
        self._j, self._names = slice(hardware.joints), hardware.joint_names
        self._balance = GravityBalance(self._names, range_nm(hardware))
        self._now = -math.inf
        self.pushed = False  # whether the joint that `watch` found was made too fast by a hand
        self._awaited_since: float | None = None

    def watch(self, now: float, held: bool, afloat: bool) -> str:
        """Process one tick. held: whether all motors hold the arm; afloat: whether the arm floats.

        Returns:
            A message naming the joint that runs away; empty: no joint runs away.
        """
        self._now = now
        dq = self._estimate.dq[self._j]
        if held and self._names:
            self._balance.advance(now, self._estimate.tau[self._j], self._impedance.weight_nm, dq)
        else:
            self._balance.reset()
        joint = self._impedance.float_speed.runs_away if afloat else None
        # A joint that supports no weight can only have been moved by a push.
        if joint is None or not self._impedance.carries(self._estimate.q[self._j], joint):
            return ""
        self.pushed = self._impedance.float_speed.pushed(joint)
        return (
            f"{self._names[joint]} goes on at {dq[joint]:.1f} rad/s though it is damped, and is held now; {CHECK}. "
            "If a hand was so fast, raise float_speed_rad_s"
        )

    def settled(self) -> str | None:
        """Return why a newly energised, holding arm must not float; "" if the arm may float, None while unknown.

        After None, call again at the next tick: a hand may still support the arm. An arm that is moved by hand all the
        time may float, since the hand holds the arm.
        """
        if self._awaited_since is None:
            self._awaited_since = self._now
        verdict = self._balance.verdict(self._now) if self._names else ""
        if verdict != "" and self._now - self._awaited_since < _PATIENCE_S:
            return None
        self._awaited_since = None
        return verdict or ""

    def check(self, arm: str) -> None:
        """Check that the arm would not run away when floating. arm: name of the arm, for the message.

        Torque that presses a joint onto the stop at an end of its range is ignored.

        Raises:
            LifeCycleError: joints would run away; the message names joints and torques.
        """
        wrong = self.weigh(_MEMORY_S)
        if wrong:
            raise LifeCycleError(f"{arm} does not float: {wrong}")

    def weigh(self, memory_s: float = 0.0) -> str | None:
        """Return why the held arm must not float; "" if it may, None while it moves. memory_s: see `GravityBalance`."""
        if not self._names:
            return ""
        hw, q = self._hardware, self._estimate.q[self._j]
        at_stop = (q > hw.upper[self._j] - _AT_STOP_RAD).astype(float) - (q < hw.lower[self._j] + _AT_STOP_RAD)
        return self._balance.verdict(self._now, at_stop, memory_s)

    @property
    def wrong_nm(self) -> np.ndarray:
        """Difference (joints,) of the torque of the arm at rest from the model's, Nm."""
        return self._balance.wrong_nm


class FloatPause:
    """Pause of a floating arm that went too fast for too long: hold it gently, weigh it, and let it float again.

    What the arm's damping took, or a squeezed trigger, tells whether a hand made it fast. Held, the arm is weighed:

        balanced, and a hand made it fast  the arm floats again
        balanced, and no hand              it floats again once a hand has touched it; untouched for 1 s: a fault
        wrong by the same torque for 1 s   it is the weight: a fault
        wrong, and the torque varies       a hand is at the arm: the pause goes on

    A second pause soon after the first ends only once a hand has touched the arm, so that nothing floats away, is held
    and floats away for ever. Meanwhile a hand may push the arm, which yields at a quarter of its torque.

    Advance once per tick.

    Args:
        actuation, floating: parts of the arm.
        suffer: called with fault, message and time.
    """

    def __init__(self, actuation: Actuation, floating: FloatMonitor, suffer: Callable[[Trouble, str, float], None]):
        self._arm, self._floating, self._suffer = actuation, floating, suffer
        self._message = ""  # why the arm is held; empty: no pause
        self._ended_s = -math.inf
        self._hand = self._touched = False  # whether a hand made the arm fast; whether it floats again once balanced
        self._since_s = math.inf  # time since which the arm rests with the same torque
        self._wrong_nm: np.ndarray = np.zeros(actuation.hardware.joints)

    def advance(self, now: float, held: bool, trigger: float) -> None:
        """Process one tick.

        Args:
            now: time, s.
            held: whether all motors hold the arm.
            trigger: the handle's trigger, 0 released … 1 squeezed; NaN without one.
        """
        arm, status = self._arm, self._arm.status
        wrong = self._floating.watch(now, held, status.afloat)
        if wrong:
            arm.setpoint.move_at(arm.estimate.dq[: arm.hardware.joints])  # a sudden stop would throw the arm
            if status.mode is not Mode.FLOAT or arm.grips:
                self._suffer(Trouble.RUNAWAY, wrong, now)
                return
            logger.warning("%s: %s. It is held until it rests and is balanced", arm.name, wrong)
            self._message, self._since_s = wrong, math.inf
            self._hand = trigger > _GRIPPED or self._floating.pushed
            self._touched = self._hand and now - self._ended_s > _SOON_S
            arm.hold_here()
            arm.impedance.gentle = True
        elif self._message and status.mode is not Mode.HOLD:
            self.end()
        if self._message and not status.halted:
            self._weigh(now)

    def end(self) -> None:
        """End the pause, because somebody else decides what the arm does."""
        self._message, self._arm.impedance.gentle = "", False

    def _weigh(self, now: float) -> None:
        arm, j = self._arm, slice(self._arm.hardware.joints)
        felt_nm = FELT_SHARE * arm.hardware.torque_limit_nm
        arm.setpoint.press_less(arm.impedance.kp, arm.impedance.sag_nm, felt_nm[j])
        verdict, nm = self._floating.weigh(), self._floating.wrong_nm
        began = math.isinf(self._since_s)
        if verdict is None:
            self._touched |= not began  # a hand moves it
            self._since_s = math.inf
            return
        varies = bool((np.abs(nm - self._wrong_nm) > _VARIES * arm.hardware.torque_limit_nm[j]).any())
        if began or (verdict and varies):
            self._touched |= not began
            self._since_s, self._wrong_nm = now, nm.copy()
        if verdict == "" and self._touched:
            logger.info("%s: floats again", arm.name)
            self._ended_s = now
            self.end()
            arm.enter(Mode.FLOAT)
        elif now - self._since_s > _WEIGHT_S and (verdict or not self._hand):
            message = self._message
            self.end()
            self._suffer(Trouble.RUNAWAY, message, now)
