"""Emergency stop of one arm: triggers that stop all arms, and the arm's response.

A handle button and excessive effort stop all arms. Effort is what a joint's motor gives beyond what the model says that
weight and motion need:

    effort = |tau − needed|

Effort above the limit for longer than a knock lasts means that the arm presses on an obstacle. A landing is not stopped
for it, since it is the way down: it gives way to obstacles by itself. While the stop is latched, an arm holds or
floats; afterwards the arm continues.
"""

import math
from collections.abc import Sequence

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.actuation import Actuation
from lerobot_robot_yam.control.fault_response import FaultResponse
from lerobot_robot_yam.control.float_monitor import FloatMonitor
from lerobot_robot_yam.control.impedance import Impedance
from lerobot_robot_yam.control.landing_response import LandingResponse
from lerobot_robot_yam.control.laws.gravity_balance import range_nm, tolerance_nm
from lerobot_robot_yam.errors import ConfigError, LifeCycleError, YamError
from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Limited

PRESS_NM = 5.0  # maximum torque with which a stopped joint keeps pressing, Nm: an unknown load of 1 kg at 0.5 m
PATIENCE_S = 0.05  # maximum time of effort above the limit, s: knocks and starts are shorter
_BUTTONS = {None: None, "top": 0, "bottom": 1}


class EffortLimit:
    """Monitor of the effort of n joints. Check once per tick.

    Args:
        limit_nm: (n,) maximum effort.
        names: (n,) joint names.
    """

    def __init__(self, limit_nm: np.ndarray, names: Sequence[str]):
        self._limit, self._names = limit_nm, names
        self._since: np.ndarray = np.full(len(limit_nm), math.inf)

    def check(self, now: float, beyond_nm: np.ndarray) -> str:
        """Return a message naming the joint farthest above its limit for over PATIENCE_S; "": no such joint.

        beyond_nm: (n,) measured torque less the torque that weight and motion need.
        """
        above = np.abs(beyond_nm) > self._limit
        self._since = np.where(above, np.minimum(self._since, now), math.inf)
        over = now - self._since > PATIENCE_S
        if not over.any():
            return ""
        worst = int(np.where(over, np.abs(beyond_nm) / self._limit, 0.0).argmax())
        limit = f"its effort limit of {self._limit[worst]:.1f} Nm"
        return f"{self._names[worst]} works with {beyond_nm[worst]:.1f} Nm beyond weight and motion, against {limit}"


class StopTriggers:
    """Stop triggers of one arm. If any exist, check once per tick.

    Attributes:
        exist: whether a stop button or an effort limit is configured.

    Raises:
        ConfigError: an effort limit is so low that a pose may exceed it; the message names joint and torque.
    """

    def __init__(self, hardware: ResolvedArm, impedance: Impedance):
        config, self._arm = hardware.config, hardware.name
        self._button = _BUTTONS[config.estop_button]
        self._down = True  # so that a button pressed at the start is ignored until its release
        self._effort: EffortLimit | None = None
        if config.effort_limit_nm is not None and hardware.joints:
            limit_nm = np.array(config.effort_limit_nm)
            _refuse_low(hardware, limit_nm, impedance.most_weight_nm())
            self._effort = EffortLimit(limit_nm, hardware.joint_names)
        self.exist = self._button is not None or self._effort is not None

    def check(self, now: float, buttons: tuple[bool, bool], beyond_nm: np.ndarray, works: bool) -> str:
        """Return the reason for an emergency stop; empty: no reason.

        Args:
            now: time, s.
            buttons: whether each button of the handle is pressed.
            beyond_nm: see `EffortLimit.check`.
            works: whether the effort limit applies at this tick.
        """
        if self._button is not None:
            before, self._down = self._down, bool(buttons[self._button])
            if self._down and not before:
                return f"button of the handle of {self._arm}"
        told = self._effort and self._effort.check(now, beyond_nm if works else np.zeros_like(beyond_nm))
        return f"{self._arm}: {told}" if told else ""


def _refuse_low(hardware: ResolvedArm, limit_nm: np.ndarray, weight_nm: np.ndarray) -> None:
    """Check that the model, which may be as wrong as for an arm that floats, exceeds no limit within the joint limits.

    Args:
        limit_nm: (joints,) effort limits.
        weight_nm: (joints,) largest modelled weight within the joint limits.

    Raises:
        ConfigError: a limit is too low.
    """
    least_nm = tolerance_nm(range_nm(hardware), weight_nm)
    low = np.flatnonzero(limit_nm < least_nm)
    if len(low):
        joint = int(low[0])
        raise ConfigError(
            f"{hardware.name}: effort_limit_nm of {hardware.joint_names[joint]} is {limit_nm[joint]:g} Nm, and within "
            f"its limits the arm holds it with up to {weight_nm[joint]:.1f} Nm, of which a model may miss "
            f"{least_nm[joint]:.1f}: give at least that. The limit is for torque beyond weight and motion"
        )


class StopResponse:
    """Responses of one arm to the emergency stop."""

    def __init__(self, actuation: Actuation, landing: LandingResponse, faults: FaultResponse, floating: FloatMonitor):
        self._actuation, self._status = actuation, actuation.status
        self._landing, self._faults, self._floating = landing, faults, floating
        self._triggers = StopTriggers(actuation.hardware, actuation.impedance)

    def reason(self, now: float, buttons: tuple[bool, bool]) -> str:
        """Return the reason for an emergency stop; empty: no reason. buttons: whether each handle button is pressed."""
        if not self._triggers.exist:
            return ""
        arm, status = self._actuation, self._status
        works = not status.ended and status.mode not in (Mode.STOPPED, Mode.FAULT, Mode.LAND)
        beyond_nm = arm.estimate.tau[: arm.hardware.joints] - arm.impedance.needed_nm
        return self._triggers.check(now, buttons, beyond_nm, works)

    def check(self, now: float) -> None:
        """Process one tick: stop while the emergency stop is latched, resume after its release."""
        if self._status.stopped:
            self._stop()
        elif self._status.mode is Mode.STOPPED:
            self._resume(now)
        elif self._status.limited:  # rare; saves the slow combination of flags
            self._status.limited &= ~Limited.EMERGENCY_STOP  # so that an arm in FAULT responds to the next stop, too

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
        status.stops_afloat = status.floats and self._may_float()
        arm.enter(Mode.STOPPED)
        self._press_less()

    def _may_float(self) -> bool:
        """Return whether the arm floats, or may float according to `FloatMonitor`; False for a landing arm."""
        if self._status.mode in (Mode.FLOAT, Mode.LAND):
            return self._status.mode is Mode.FLOAT
        try:
            self._floating.check(self._actuation.name)
        except LifeCycleError:
            return False
        return True

    def _press_less(self) -> None:
        """Limit the joints' pull to the torque of a small load: a person may be in the arm's way."""
        impedance = self._actuation.impedance
        self._actuation.setpoint.press_less(impedance.kp, impedance.sag_nm, PRESS_NM)

    def _resume(self, now: float) -> None:
        """Resume from the measured pose after the release of the emergency stop."""
        arm, status = self._actuation, self._status
        status.limited &= ~Limited.EMERGENCY_STOP
        arm.setpoint.start_joints()
        if arm.gripper is not None and arm.gripper.stops is None and not status.must_land:
            try:
                arm.gripper.begin()
            except YamError as error:
                self._faults.suffer(Trouble.GRIPPER, str(error), now)
                return
            arm.enter(Mode.BRING_UP)
            return
        floats = status.stops_afloat and not (status.must_land or status.halted)
        arm.enter(Mode.FLOAT if floats else Mode.HOLD)
        if status.must_land:
            status.must_land = False
            self._landing.land(now, status.trouble, status.message)
