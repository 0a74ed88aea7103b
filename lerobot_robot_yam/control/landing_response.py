"""The response of an arm to a request to land, from its first tick until torque is cut; `landing` plans the way."""

import logging
import math

import numpy as np

from lerobot_robot_yam.control.actuation import Actuation
from lerobot_robot_yam.control.joints.joint_interface import JointInterface
from lerobot_robot_yam.control.landing.landing import Landing
from lerobot_robot_yam.control.landing.landing_move import Phase, Seen
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.state.modes import Mode

logger = logging.getLogger(__name__)

_END_AGAIN_S = 1.0
_OFF_S = 0.05  # wait for motors to report that they are off, s; the adapter's delay is added
_UNREACHABLE_S = 1.0  # time out of reach, s, after which the motors' watchdogs have let go and nothing is left to land


class LandingResponse:
    """Landings of one arm."""

    def __init__(self, actuation: Actuation, interface: JointInterface):
        self._actuation, self._interface, self._status = actuation, interface, actuation.status
        self._off_by_s = math.inf
        self._end_again_at = -math.inf
        self._unreachable_since: float | None = None

    def land(self, now: float, trouble: Trouble | None = None, message: str = "") -> None:
        """Begin to land. An arm that lands or is off already is left alone; an emergency stop delays the landing."""
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
        for joint in np.flatnonzero(~np.isfinite(arm.setpoint.q)):  # after a defect of our own code
            arm.setpoint.start_one(int(joint))
        if joints:
            arm.landing = Landing(arm.hardware, arm.q[:joints], arm.setpoint, now)
        else:
            self.switch_off()  # a gripper alone falls nowhere

    def end(self, now: float) -> None:
        """Land because the caller is gone. Call every tick: after a fault on its way the arm tries again."""
        status = self._status
        if now < self._end_again_at or status.rearming or (status.mode is Mode.FAULT and status.stopped):
            return
        self._end_again_at = now + _END_AGAIN_S
        self.land(now, status.trouble, status.message)

    def cancel(self) -> None:
        """End the landing."""
        self._actuation.end_landing()

    def _obeys_unbelieved(self) -> bool:
        """Return whether a motor with distrusted readings answers: it has torque, and must be brought down."""
        chain = self._actuation.chain
        return bool((chain.distrusted & (chain.missed == 0)).any())

    def _pulls(self) -> np.ndarray:
        """Return (joints,) the way, -1 or 1, in which weight pulls a joint that is not heard and may obey; else 0."""
        arm, weight_nm = self._actuation, self._actuation.impedance.weight_nm
        heavy = np.abs(weight_nm) > arm.hardware.arm.coulomb_friction_nm
        unheard = arm.estimate.unheard()[: arm.hardware.joints] & ~arm.setpoint.sunk
        return np.where(unheard & heavy, -np.sign(weight_nm), 0.0)

    def advance(self, now: float) -> None:
        """Advance a landing by one tick; cut torque once the arm has landed."""
        arm, status, landing = self._actuation, self._status, self._actuation.landing
        if landing is None:
            return
        joints = slice(arm.hardware.joints)
        if arm.bus_loss.lost or not (arm.estimate.usable.any() or self._obeys_unbelieved()):
            self._unreachable_since = self._unreachable_since or now
            if now - self._unreachable_since > _UNREACHABLE_S:
                status.message = status.message or "nothing reaches the arm; its motors have let go by themselves"
                logger.error("%s: cannot be landed: %s", arm.name, status.message)
                self.cancel()
                status.enter(Mode.OFF)
                return
        else:
            self._unreachable_since = None
        before = landing.phase
        q, dq, usable = arm.q[joints], arm.estimate.dq[joints], arm.estimate.usable[joints]
        explained = arm.impedance.explains(q, np.where(usable, arm.setpoint.q[joints] - q, 0.0))
        landing.advance(Seen(now, q, dq, usable, explained, self._pulls()))
        if landing.phase is Phase.OBSTRUCTED and before is not Phase.OBSTRUCTED:
            status.trouble, status.message = Trouble.OBSTRUCTED, "landing is obstructed; holding"
        if landing.phase is Phase.LANDED:
            self.cancel()
            logger.info("%s: landed", arm.name)
            self.switch_off()

    def switch_off(self) -> None:
        """Cut torque over the next ticks. Call this only in a landed pose, or where the arm was limp a moment ago.

        Raises:
            LifeCycleError: the present mode forbids it.
        """
        self._status.check(Mode.OFF)
        self._status.letting_go = True
        chain = self._actuation.chain
        self._off_by_s = chain.clock.now() + _OFF_S + 2.0 * chain.round_trip.one_way_s
        self._disable()

    def _disable(self) -> None:
        self._interface.instead = dict.fromkeys(range(self._actuation.hardware.n), SpecialCommand.DISABLE)

    def let_go(self, now: float) -> None:
        """Advance switching off by one tick: the arm is off once every motor has reported so, or its time is over."""
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
