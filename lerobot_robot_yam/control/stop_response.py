"""The emergency stop of one arm: what it does while the stop is latched, and how it goes on after that."""

import numpy as np

from lerobot_robot_yam.control.actuation import Actuation
from lerobot_robot_yam.control.fault_response import FaultResponse
from lerobot_robot_yam.control.landing_response import LandingResponse
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Limited

PRESS_NM = 5.0  # with which a stopped joint presses on: 1 kg at 0.5 m that the model does not know


class StopResponse:
    """Responses of one arm."""

    def __init__(self, actuation: Actuation, landing: LandingResponse, faults: FaultResponse):
        self._actuation, self._status = actuation, actuation.status
        self._landing, self._faults = landing, faults

    def check(self, now: float) -> None:
        """One tick: stop while the emergency stop is latched, go on once it is released."""
        if self._status.stopped:
            self._stop()
        elif self._status.mode is Mode.STOPPED:
            self._resume(now)

    def _stop(self) -> None:
        arm, status = self._actuation, self._status
        latched_now = not status.limited & Limited.EMERGENCY_STOP
        status.limited |= Limited.EMERGENCY_STOP
        if status.mode is Mode.FAULT and latched_now:
            self._press_less()
        if status.ended or status.mode in (Mode.STOPPED, Mode.FAULT):
            return
        if status.mode is Mode.LAND:
            self._landing.cancel()
            status.must_land = True
        arm.stop_moving()
        arm.enter(Mode.STOPPED)
        self._press_less()

    def _press_less(self) -> None:
        """Reduce what the joints pull with to what carries a load: a person may be in the arm's way."""
        arm = self._actuation
        joints = arm.hardware.joints
        kp, sag = np.maximum(arm.hardware.kp[:joints], 1.0), arm.impedance.sag_nm
        here = arm.here
        gap = (arm.setpoint.q - here)[:joints]
        least = np.minimum(np.maximum(gap, (-PRESS_NM - sag) / kp), (PRESS_NM - sag) / kp)
        for joint in np.flatnonzero(least != gap):
            arm.setpoint.reseed(int(joint), float(here[joint] + least[joint]))

    def _resume(self, now: float) -> None:
        """Go on from the measured pose: the emergency stop has been released."""
        arm, status = self._actuation, self._status
        status.limited &= ~Limited.EMERGENCY_STOP
        arm.seed_joints()
        if arm.gripper is not None and arm.gripper.stops is None and not status.must_land:
            try:
                arm.gripper.begin()
            except YamError as error:
                self._faults.suffer(Trouble.GRIPPER, str(error), now)
                return
            arm.enter(Mode.BRING_UP)
            return
        floats = status.floats and not (status.must_land or status.halted)
        arm.enter(Mode.FLOAT if floats else Mode.HOLD)
        if status.must_land:
            status.must_land = False
            self._landing.land(now, status.trouble, status.message)
