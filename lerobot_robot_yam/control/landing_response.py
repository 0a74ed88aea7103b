"""The response of an arm to a request to land, from its first tick until torque is cut; `landing` plans the way."""

import logging
import math

import numpy as np

from lerobot_robot_yam.control.actuation import Actuation
from lerobot_robot_yam.control.landing.landing import Landing
from lerobot_robot_yam.control.landing.landing_move import Phase, Seen
from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.state.modes import Mode

logger = logging.getLogger(__name__)

_END_AGAIN_S = 1.0
_UNREACHABLE_S = 1.0  # beyond their watchdog, the motors have let go: there is nothing left to land


class LandingResponse:
    """Landings of one arm."""

    def __init__(self, actuation: Actuation):
        self._actuation, self._status = actuation, actuation.status
        self._end_again_at = -math.inf
        self._unreachable_since: float | None = None

    def land(self, now: float, trouble: Trouble | None = None, message: str = "") -> None:
        """Begin to land. An arm that lands or is off already is left alone; an emergency stop is waited for."""
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
        for joint in np.flatnonzero(~np.isfinite(arm.setpoint.q)):  # a defect of our own code: it goes on from here
            arm.setpoint.start_one(int(joint))
        if joints:
            arm.landing = Landing(arm.hardware, arm.q[:joints], arm.setpoint, now)
        else:
            arm.switch_off()  # a gripper alone falls nowhere

    def end(self, now: float) -> None:
        """Land because the caller is gone. Ask every tick: after a fault on its way the arm tries again."""
        status = self._status
        if now < self._end_again_at or status.rearming or (status.mode is Mode.FAULT and status.stopped):
            return
        self._end_again_at = now + _END_AGAIN_S
        self.land(now, status.trouble, status.message)

    def cancel(self) -> None:
        """Land no more."""
        self._actuation.end_landing()

    def _obeys_unbelieved(self) -> bool:
        """Whether a motor answers, though its readings are not used: it has its torque, and must be brought down."""
        chain = self._actuation.chain
        return bool((chain.distrusted & (chain.missed == 0)).any())

    def _pulls(self) -> np.ndarray:
        """(joints,) the way, -1 or 1, in which its weight pulls a joint that is not heard and may obey; else 0."""
        arm, weight_nm = self._actuation, self._actuation.impedance.weight_nm
        heavy = np.abs(weight_nm) > arm.hardware.arm.coulomb_friction_nm
        unheard = arm.estimate.unheard()[: arm.hardware.joints] & ~arm.setpoint.sunk
        return np.where(unheard & heavy, -np.sign(weight_nm), 0.0)

    def advance(self, now: float) -> None:
        """Move the set-point of a landing on; cut torque once that moves nothing."""
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
            arm.switch_off()
