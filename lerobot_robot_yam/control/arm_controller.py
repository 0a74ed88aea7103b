"""Controller of one arm: changes the mode on requests, targets, faults and the emergency stop.

The controller has no clock of its own and never blocks. `actuation` moves the arm; `bring_up`, `landing_response`,
`fault_response` and `stop_response` implement the mode changes.
"""

import logging
import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import can
import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.actuation import Actuation
from lerobot_robot_yam.control.arm_status import ArmStatus
from lerobot_robot_yam.control.bring_up import BringUp
from lerobot_robot_yam.control.fault_response import RELEASE_FIRST, FaultResponse
from lerobot_robot_yam.control.float_monitor import FloatMonitor, FloatPause
from lerobot_robot_yam.control.gripper.handle_reader import NO_HANDLE
from lerobot_robot_yam.control.joints.joint_interface import JointInterface
from lerobot_robot_yam.control.landing_response import LandingResponse
from lerobot_robot_yam.control.rearm import Rearm
from lerobot_robot_yam.control.safety.progress_monitor import ProgressMonitor
from lerobot_robot_yam.control.safety.thermal_monitor import Heat, Stage, ThermalMonitor
from lerobot_robot_yam.control.stop_response import StopResponse
from lerobot_robot_yam.control.teleop.coupling import Coupling
from lerobot_robot_yam.control.teleop.lead import Lead
from lerobot_robot_yam.errors import BusError, LifeCycleError, MotorError
from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Limited, Request
from lerobot_robot_yam.system.clock import Clock
from lerobot_robot_yam.system.few_values import largest

if TYPE_CHECKING:
    from lerobot_robot_yam.arm.dynamics import GravityModel

logger = logging.getLogger(__name__)

_HEAT_PERIOD_S = 0.1  # period of temperature checks, s: temperatures change slowly
_UNHEARD_S = 0.03  # maximum age of the oldest reply before the set-point stops, s: seven ticks
_HELD = (Mode.BRING_UP, Mode.HOLD, Mode.TRACK, Mode.FAULT)


class ArmController:
    """Controller of the arm on one channel.

    Bring-up: `inspect` (energises nothing), `bring_up.energise`. Then at each tick: `send`, `collect`, `measure`,
    `decide`, the set-point's `step`, `actuation.compute_command`.

    Args:
        hardware: the arm.
        bus: an open bus; the caller closes it.
        gravity: the arm's gravity model; None: create one.

    Attributes:
        lead: the teleoperation side of a leader; None if the arm leads no follower.
        coupling: coupling to a leader that this arm may follow at loop rate.
    """

    def __init__(self, hardware: ResolvedArm, bus: can.BusABC, gravity: "GravityModel | None" = None):
        self.config, self.name = hardware.config, hardware.name
        self.status = status = ArmStatus(self.name, floats=self.config.start == "float")
        self.interface = JointInterface(hardware, bus)
        self.actuation = arm = Actuation(hardware, self.interface, status, gravity)
        self._floating = FloatMonitor(arm.estimate, arm.impedance, hardware)
        self.bring_up = BringUp(arm, self.interface, self._floating)
        self.landing = LandingResponse(arm, self.interface)
        self.faults = FaultResponse(Rearm(arm, self.interface), arm, self.landing, self.bring_up, self._floating)
        self._pause = FloatPause(arm, self._floating, self.faults.suffer)
        self._stop = StopResponse(arm, self.landing, self.faults, self._floating)
        self.energise, self.end, self.advance = self.bring_up.energise, self.landing.end, arm.setpoint.step
        self.start_send, self.start_receive = arm.send, self.interface.receive
        self.compute_command = arm.compute_command
        self.fail, self.halt, self.take_news = self.faults.fail, self.faults.halt, self.faults.take_news
        self.complaints = self.interface.complaints
        self._progress = ProgressMonitor(self.name, hardware.joint_names)
        self._last_target_at = self._heat_due_s = -math.inf
        self._heat: Heat | None = None
        self.lead: Lead | None = None
        self.coupling, self.handle = Coupling(hardware), NO_HANDLE

    @property
    def mode(self) -> Mode:
        """The present mode, see `status` for details."""
        return self.status.mode

    @property
    def clock(self) -> Clock:
        """The clock of the arm's channel."""
        return self.interface.chain.clock

    @property
    def lost(self) -> int:
        """Number of replies that never came."""
        return int(self.interface.chain.lost.sum())

    @property
    def wire_s(self) -> float:
        """Time for which the frames of one tick occupy the bus, s."""
        return self.interface.chain.expected_wire_s

    def close(self) -> None:
        """Do nothing: an arm opens nothing itself."""

    def send(self) -> None:
        """Send this tick's commands, or the last valid commands if encoding fails."""
        self._talk(self._send)

    def _send(self) -> None:
        try:
            self.actuation.send()
        except BusError:
            raise
        except Exception as error:
            self.faults.fail(error)
            self.actuation.send()

    def drain(self) -> None:
        """Process the replies received so far, without waiting."""
        self._talk(self.interface.chain.drain)

    def collect(self, until_s: float) -> None:
        """Process the replies to this tick's commands; wait for late replies until `until_s`."""
        self._talk(lambda: self.interface.chain.collect(until_s))

    def _talk(self, work: Callable[[], object]) -> None:
        """Run `work`, which sends or receives frames; respond to a lost channel."""
        try:
            work()
        except BusError as error:
            self.faults.lose_bus(error, self.clock.now())
        except Exception as error:  # the other arms still need commands
            self.faults.fail(error)

    def inspect(self) -> None:
        """Check that all parts reply and match the configuration, without moving or energising a motor.

        Raises:
            YamError: a part is missing or differs from the configuration; the message names the part.
        """
        self.interface.inspect()

    def adopt(self, record: np.ndarray, now: float) -> None:
        """Take over from a dead loop, and land. record: last state published by the dead loop.

        An arm without an enabled motor is left limp.
        """
        arm = self.actuation
        self.interface.adopt(record)
        arm.setpoint.sunk = record["sunk"][: arm.hardware.joints].astype(bool)
        arm.check(now)
        if arm.estimate.heard().all() and not arm.estimate.usable.any():
            self.status.enter(Mode.OFF)
            return
        arm.setpoint.adopt(record)
        self.landing.land(now, Trouble.CONTROL_DEAD, "its control process has died; the stand-by lands it")
        arm.compute_command(now, 0.0)  # else the first tick would send zeros

    def abandon(self) -> None:
        """Cut torque during bring-up, over the next ticks. Safe because the limp arm has not left its pose."""
        if not self.status.ended:
            self.landing.switch_off()

    def measure(self, now: float) -> None:
        """Update the arm's state from the replies; respond to faults according to the table in `state.faults`."""
        arm, status = self.actuation, self.status
        arm.estimate.read()
        if self.interface.handle is not None:
            self.handle = self.interface.handle.read(now)
        if status.letting_go:
            self.landing.let_go(now)
            return
        if status.ended:
            return
        finding = arm.check(now)
        if finding.trouble is not None:
            self.faults.suffer(finding.trouble, finding.message, now)
        if self.interface.heat is not None:
            self._derate(now, self.interface.heat)
        if self.lead is not None:
            sample = arm.q, arm.estimate.dq, arm.chain.stamp_s
            mode = None if status.halted else status.mode
            self.lead.advance(now, mode, sample, self.handle[:3], arm.impedance.weight_nm)
            arm.assist = self.lead.assist

    def _derate(self, now: float, monitor: ThermalMonitor) -> None:
        """Reduce speed (not while landing) and grip force if motors are WARM; land the arm if motors are HOT."""
        arm, status, heat = self.actuation, self.status, self._heat
        if heat is None or now >= self._heat_due_s:
            heat = self._heat = monitor.check(now, arm.chain.temp_mos_c, arm.chain.temp_rotor_c)
            self._heat_due_s = now + _HEAT_PERIOD_S
            if arm.gripper is not None:
                arm.gripper.derate(float(heat.level[-1]))
            if arm.landing is None:
                arm.setpoint.limit_speed(arm.hardware.speed_limit * heat.speed_scale)
        if heat.stage:
            status.limited |= Limited.HEAT
            if heat.stage is Stage.HOT and status.mode is Mode.FAULT:
                self.landing.end(now)  # land while the other motors still obey
            elif heat.stage is Stage.HOT and not status.must_land:
                self.faults.suffer(Trouble.HOT, heat.message, now)

    def stop_reason(self, now: float) -> str:
        """Return the reason for an emergency stop (handle button, excessive effort); empty: no reason."""
        handle = self.interface.handle
        return self._stop.reason(now, NO_HANDLE.buttons if handle is None else handle.raw_buttons)

    def decide(self, now: float) -> None:
        """Update mode and set-point target for this tick; the loop steps the set-point afterwards."""
        arm, status = self.actuation, self.status
        if status.letting_go:
            return
        self._stop.check(now)
        self._pause.advance(now, status.mode in _HELD and arm.estimate.all_usable, self.handle[0])
        self.faults.advance()
        if status.mode is Mode.BRING_UP:
            trouble = self.bring_up.advance(now)
            if trouble is not None:
                self.faults.suffer(*trouble, now)
        if self.coupling.active:
            self._follow_leader(now)
        arm.impedance.coupled = self.coupling.number != 0
        obeys = status.mode is Mode.TRACK or (status.mode is Mode.FLOAT and arm.grips)
        if obeys and now - self._last_target_at > self.config.command_timeout_s:
            status.limited |= Limited.COMMAND_TIMEOUT
            logger.info("%s: no target for %g s; it holds", self.name, self.config.command_timeout_s)
            self.coupling.end()
            arm.hold_here()
        if status.mode is Mode.TRACK and now - arm.estimate.oldest_s() > _UNHEARD_S + arm.chain.round_trip.one_way_s:
            arm.setpoint.stop()  # else the set-point runs ahead of an unreachable arm, which rushes to it later
            status.limited |= Limited.UNHEARD
        if arm.landing is not None:
            self.landing.advance(now)
        elif status.mode in (Mode.HOLD, Mode.TRACK):
            j = slice(arm.hardware.joints)
            gap = (arm.setpoint.q - arm.setpoint.here)[j]
            self._progress.by_obstacle(now, gap, arm.impedance.kp[j], arm.hardware.torque_limit_nm[j])

    def set_target(
        self,
        target: np.ndarray,
        now: float,
        velocity: np.ndarray | None = None,
        kp: np.ndarray | None = None,
        kd: np.ndarray | None = None,
        age_s: float = 0.0,
    ) -> bool:
        """Accept a target (n,), gripper 0 … 1, issued `age_s` ago; return False if the arm neither holds nor tracks.

        An arm guided by hand keeps floating; only its gripper moves to the target.
        """
        arm, status = self.actuation, self.status
        if status.mode is Mode.FLOAT and arm.grips and not status.halted:
            self._last_target_at = now
            arm.setpoint.set_target(target, now)  # each tick resets the joints' targets to their positions
            return True
        if status.mode not in (Mode.HOLD, Mode.TRACK) or status.halted:
            return False
        self._last_target_at = now
        arm.use_gains(kp, kd)
        self._note_target(target)
        arm.setpoint.set_target(target, now, velocity, age_s)
        return True

    def _note_target(self, target: np.ndarray) -> None:
        arm, status = self.actuation, self.status
        gap = largest((target - arm.setpoint.q)[: arm.hardware.joints])
        status.limited = Limited.SPEED if self._progress.by_speed(gap) else Limited.NOTHING
        if status.mode is Mode.HOLD:
            arm.enter(Mode.TRACK)

    def _follow_leader(self, now: float) -> None:
        """Set this tick's target from the leader, while the caller's last permission is recent."""
        arm, status, coupling = self.actuation, self.status, self.coupling
        self._last_target_at = max(self._last_target_at, coupling.permitted_s)
        late = now - self._last_target_at > self.config.command_timeout_s
        if late or status.mode not in (Mode.HOLD, Mode.TRACK) or status.halted:
            coupling.end()
            return
        setpoint, followed = arm.setpoint, coupling.number != 0
        if not coupling.advance(now, (setpoint.q, setpoint.dq), arm.q):
            if followed:  # a lost leader
                setpoint.stop()
            return
        if not arm.impedance.own_gains:
            arm.use_gains()
        self._note_target(coupling.target)
        if coupling.held_back:
            status.limited |= Limited.RELATIVE_TARGET
        setpoint.track(coupling.target, coupling.velocity, now, coupling.velocity_age_s)

    def change_gains(self, kp: np.ndarray, kd: np.ndarray) -> None:
        """Change the arm's own gains (n,); NaN: as configured. Raises LifeCycleError: the arm is landing."""
        if self.mode is Mode.LAND:
            raise LifeCycleError(f"{self.name}: it lands with the configured gains; change them once it is up again")
        self.actuation.change_gains(kp, kd)

    def held_back(self, by: str) -> None:
        """Record whether the workspace guard blocks the set-point. by: names of the parts in conflict, or empty."""
        if self._progress.by_workspace(by):
            self.status.limited |= Limited.WORKSPACE

    def request(self, request: Request, now: float) -> None:
        """Execute a request, possibly over several ticks (`status.busy`); then `status.refusal` reports a failure.

        Raises:
            YamError: the request is not allowed in the present mode, or fails.
        """
        arm, status = self.actuation, self.status
        if request is Request.LAND:
            if status.mode is Mode.FAULT and status.stopped:
                raise LifeCycleError(f"{self.name}: {status.message}; {RELEASE_FIRST}")
            self.landing.land(now)
        elif request is Request.CUT_TORQUE:
            arm.enter(Mode.LAND)
            self.landing.switch_off()
        elif request is Request.REARM:
            self.faults.rearm()
        elif status.mode is Mode.FAULT:
            raise LifeCycleError(f"{self.name}: {status.message}; re-arm it first")
        elif request is Request.HOLD:
            self._pause.end()
            if status.mode is Mode.BRING_UP:
                self.bring_up.after = Mode.HOLD
            elif status.mode not in (Mode.HOLD, Mode.STOPPED):
                status.check(Mode.HOLD)
                arm.hold_here()
        elif request in (Request.FLOAT, Request.GUIDE):
            if status.mode is Mode.BRING_UP:
                self.bring_up.after = Mode.FLOAT
            elif status.mode not in (Mode.FLOAT, Mode.STOPPED):
                self._floating.check(self.name)
                arm.enter(Mode.FLOAT)
            arm.grips = request is Request.GUIDE and status.mode is Mode.FLOAT
            if arm.grips:
                self._last_target_at = now  # guiding ends when targets stop arriving
        elif request is Request.CALIBRATE_GRIPPER:
            if arm.gripper is None:
                raise MotorError(f"{self.name}: {arm.hardware.gripper.name} has no motor to calibrate")
            if status.stopped:
                raise LifeCycleError(f"{self.name}: the fingers keep what they hold; {RELEASE_FIRST}")
            before = Mode.FLOAT if status.mode is Mode.FLOAT else Mode.HOLD
            arm.enter(Mode.BRING_UP)
            self.bring_up.after = before
            arm.setpoint.stop()
            arm.gripper.begin(calibrate=True)
