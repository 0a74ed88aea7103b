"""Response of an arm to a landing request, from the first tick until torque is cut; `landing` plans the motion."""

import logging
import math

import numpy as np

from lerobot_robot_yam.control.actuation import Actuation
from lerobot_robot_yam.control.joints.joint_interface import JointInterface
from lerobot_robot_yam.control.landing.landing import Landing
from lerobot_robot_yam.control.landing.landing_move import Phase, Seen
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.state.faults import SILENT_S, Trouble
from lerobot_robot_yam.state.modes import Mode

logger = logging.getLogger(__name__)

_END_AGAIN_S = 1.0
_OFF_S = 0.05  # timeout of the motors' reports that they are disabled, s; the adapter's delay is added
_UNREACHABLE_S = 1.0  # time without connection after which the landing ends, s: the motors' watchdogs have cut torque


class LandingResponse:
    """Response of one arm to landing requests."""

    def __init__(self, actuation: Actuation, interface: JointInterface):
        self._actuation, self._interface, self._status = actuation, interface, actuation.status
        self._off_by_s = math.inf
        self._end_again_at = -math.inf
        self._unreachable_since: float | None = None

    def land(self, now: float, trouble: Trouble | None = None, message: str = "") -> None:
        """Begin a landing, unless the arm is already landing or off. An emergency stop delays the landing."""
        arm, status = self._actuation, self._status
        if status.mode in (Mode.LAND, Mode.OFF):
            return
        if status.mode is Mode.OFFLINE and trouble is None:
            status.enter(Mode.OFF)
            return
        status.trouble, status.message = trouble, message
        if status.mode is Mode.STOPPED:
            status.must_land = True
            return
        arm.enter(Mode.LAND)
        if arm.gripper is not None:
            arm.gripper.stop_search()
        joints = arm.hardware.joints
        for joint in np.flatnonzero(~np.isfinite(arm.setpoint.q)):  # after an internal error
            arm.setpoint.start_one(int(joint))
        if joints:
            arm.landing = Landing(arm.hardware, arm.q[:joints], arm.setpoint, now)
        else:
            self.switch_off()  # a gripper without arm cannot fall

    def end(self, now: float) -> None:
        """Land, even from FAULT. Call every tick: after a fault during the landing, the arm retries."""
        status = self._status
        if status.mode is Mode.FAULT and not status.rearming and self._is_lost(now):
            return  # also where each tick of the landing fails, or an emergency stop delays it
        if now < self._end_again_at or status.rearming or (status.mode is Mode.FAULT and status.stopped):
            return
        self._end_again_at = now + _END_AGAIN_S
        self.land(now, status.trouble, status.message)

    def cancel(self) -> None:
        """End the landing."""
        self._actuation.end_landing()

    def _obeys_unbelieved(self) -> bool:
        """Return whether a motor with distrusted readings replies: such a motor has torque and must be landed."""
        chain = self._actuation.chain
        return bool((chain.distrusted & (chain.missed == 0)).any())

    def _pulls(self) -> np.ndarray:
        """Return (joints,) direction of gravity, -1 or 1, for joints with silent motors that may obey; else 0."""
        arm, weight_nm = self._actuation, self._actuation.impedance.weight_nm
        heavy = np.abs(weight_nm) > arm.hardware.arm.coulomb_friction_nm
        unheard = arm.estimate.unheard()[: arm.hardware.joints] & ~arm.setpoint.sunk
        return np.where(unheard & heavy, -np.sign(weight_nm), 0.0)

    def advance(self, now: float) -> None:
        """Advance the landing by one tick; cut torque once the arm has landed."""
        arm, status, landing = self._actuation, self._status, self._actuation.landing
        if landing is None:
            return
        if self._is_lost(now):
            return
        joints = slice(arm.hardware.joints)
        before = landing.phase
        q, dq, usable = arm.q[joints], arm.estimate.dq[joints], arm.estimate.usable[joints]
        explained = arm.impedance.explains(q, np.where(usable, arm.setpoint.q[joints] - q, 0.0))
        landing.advance(Seen(now, q, dq, usable, explained, self._pulls()))
        if landing.phase is Phase.OBSTRUCTED and before is not Phase.OBSTRUCTED:
            status.trouble = Trouble.OBSTRUCTED
            status.message = "landing is obstructed, or somebody holds the arm; holding"
        if landing.phase is Phase.LANDED:
            self.cancel()
            logger.info("%s: landed", arm.name)
            self.switch_off()

    def _is_lost(self, now: float) -> bool:
        """Return whether nothing has reached the arm for `_UNREACHABLE_S`; such an arm is off."""
        arm, status = self._actuation, self._status
        heard = arm.chain.silence_s(now).min() < SILENT_S  # False also where each tick fails before a reply is read
        if heard and not arm.bus_loss.lost and (arm.estimate.usable.any() or self._obeys_unbelieved()):
            self._unreachable_since = None
            return False
        self._unreachable_since = self._unreachable_since or now
        if now - self._unreachable_since <= _UNREACHABLE_S:
            return False
        status.message = status.message or "nothing reaches the arm; its motors have let go by themselves"
        logger.error("%s: cannot be landed: %s", arm.name, status.message)
        self.cancel()
        status.enter(Mode.OFF)
        return True

    def switch_off(self) -> None:
        """Cut torque over the next ticks. Call only in a landed pose, or for an arm that was limp just before.

        Raises:
            LifeCycleError: the present mode has no transition to OFF.
        """
        self._status.check(Mode.OFF)
        self._status.letting_go = True
        chain = self._actuation.chain
        self._off_by_s = chain.clock.now() + _OFF_S + 2.0 * chain.round_trip.one_way_s
        self._disable()

    def _disable(self) -> None:
        self._interface.instead = dict.fromkeys(range(self._actuation.hardware.n), SpecialCommand.DISABLE)

    def let_go(self, now: float) -> None:
        """Advance switching off by one tick: the arm is off once all motors have reported so, or after a timeout."""
        arm, status = self._actuation, self._status
        on = np.flatnonzero(arm.chain.fault == Fault.NORMAL)
        if len(on) and now < self._off_by_s:
            self._disable()
            return
        if len(on):
            names = ", ".join(arm.chain.motors[i].name for i in on)
            logger.error("%s: %s did not say that they are off; their watchdogs switch them off", arm.name, names)
        status.enter(Mode.OFF)
        status.letting_go = False
