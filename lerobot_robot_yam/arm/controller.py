"""One arm at one tick: state in, MIT commands out, and the life cycle in between. No clock, no waiting in here."""

import logging
import math
import time

import can
import numpy as np

from lerobot_robot_yam.arm import laws
from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.dynamics import GravityModel
from lerobot_robot_yam.arm.gripper_axis import GripperAxis
from lerobot_robot_yam.arm.hardware import Hardware
from lerobot_robot_yam.arm.joints import JointMap, resolve_turn
from lerobot_robot_yam.arm.landing import Landing, Phase
from lerobot_robot_yam.arm.lifecycle import Mode, check_transition
from lerobot_robot_yam.arm.setpoint import SetPoint
from lerobot_robot_yam.arm.state import Limited, Request
from lerobot_robot_yam.arm.watch import HandleWatch, MotorWatch
from lerobot_robot_yam.damiao.bringup import LISTEN_S, check_bandwidth, listen, verify
from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.encoder import HandleEncoder
from lerobot_robot_yam.damiao.handle_check import prepare_handle
from lerobot_robot_yam.damiao.quantisation import Quantiser
from lerobot_robot_yam.damiao.tables import fault_text
from lerobot_robot_yam.errors import MotorError, YamError

logger = logging.getLogger(__name__)

ACCELERATION_LIMIT_RAD_S2 = 30.0  # brakes from the speed limit within 50 ms
_GRIPPER_ACCELERATION = 60.0  # strokes/s²
_LANDING_KD = 5.0  # Nm s/rad, the most that the motors take: what is still unsupported sinks slowly


class ArmController:
    """Drives the motors of one channel.

    Bring-up: `inspect` (energises nothing), `energise`, then ticks: `send`, `collect`, `update`.

    Args:
        config: the arm.
        bus: an open bus; the controller does not close it.
    """

    def __init__(self, config: ArmConfig, bus: can.BusABC):
        self.config = config
        self.name = config.name
        self.hardware = hw = Hardware(config)
        self.encoder = HandleEncoder() if hw.gripper.handle_encoder else None
        self.chain = MotorChain(bus, hw.motors, channel=config.channel, encoder=self.encoder)
        self._bus = bus
        self._quantiser = Quantiser([motor.type for motor in hw.motors])
        self._map = JointMap(hw.direction, np.zeros(hw.n))
        self._gravity = GravityModel(hw.arm, hw.gripper, load=hw.load) if hw.joints else None
        self.setpoint = SetPoint(
            hw.speed_limit,
            np.append(np.full(hw.joints, ACCELERATION_LIMIT_RAD_S2), [_GRIPPER_ACCELERATION] * hw.has_gripper),
            hw.lower,
            hw.upper,
        )
        self.mode = Mode.OFFLINE
        self.message = ""
        self.limited = Limited.NOTHING
        self.q = np.zeros(hw.n)  # the gripper's entry is 0 closed … 1 open
        self.dq = np.zeros(hw.n)
        self.tau = np.zeros(hw.n)
        self.gripper = None
        if hw.has_gripper:
            self.gripper = GripperAxis(config, hw.gripper, float(hw.kp[-1]), float(hw.kd[-1]))
        self._motor_q = np.zeros(hw.n)  # joint-space motor angles, gripper in rad
        self._motor_dq = np.zeros(hw.n)
        self._commands = np.zeros((hw.n, 5))
        self._sent = np.zeros((hw.n, 5))
        self._kp, self._kd = hw.kp.copy(), hw.kd.copy()
        self._usable = np.ones(hw.n, dtype=bool)
        self._after_search = Mode.HOLD
        self._landing: Landing | None = None
        self._last_target_at = -math.inf
        self._motor_watch = MotorWatch(self.chain)
        self.handle = HandleWatch(self.name, self.encoder)

    def inspect(self) -> None:
        """Is everything there and as configured? Sends no command that moves or energises anything.

        Raises:
            YamError: names the part that is not.
        """
        config, chain = self.config, self.chain
        check_bandwidth(len(chain), self.encoder is not None, config.rate_hz)
        if not config.skip_listen:
            listen(self._bus, LISTEN_S, [m.can_id for m in chain.motors], config.channel)
        verify(chain)
        if self.encoder is not None:
            prepare_handle(self._bus, config.channel)
        chain.refresh()
        self._read()
        arm = self.hardware.arm
        for index in range(self.hardware.joints):
            joint, (low, high) = arm.motors[index].name, arm.joint_limits_rad[index]
            self._map.shift(index, resolve_turn(self.name, joint, float(self._motor_q[index]), low, high))
        if self.gripper is not None:
            self.gripper.begin()
        self._read()
        stale = {m.name: fault_text(f) for m, f in zip(chain.motors, chain.fault.tolist(), strict=True) if f > 1}
        if stale:
            logger.warning("%s: clearing what an earlier session left behind: %s", self.name, stale)
            chain.special(SpecialCommand.CLEAR)

    def energise(self) -> None:
        """Enable the motors, holding the measured pose from the first command on.

        Raises:
            MotorError: a motor does not enable; those that did are disabled again (the arm was limp before).
        """
        check_transition(self.name, self.mode, Mode.BRING_UP)
        self._after_search = Mode.FLOAT if self.config.start == "float" else Mode.HOLD
        self.setpoint.seed(self.q)
        self._compute(0.0)
        try:
            self.chain.special(SpecialCommand.ENABLE)
            self.chain.exchange(self._packable())
            _, trouble = self._motor_watch.check(time.monotonic())
            if trouble:
                raise MotorError(
                    f"{self.name} ({self.config.channel}): cannot enable {trouble}; "
                    "power-cycle the arm or look at its motors"
                )
        except YamError:
            self._switch_off()
            raise
        self.mode = Mode.BRING_UP

    def abandon(self) -> None:
        """Cut torque during bring-up: the arm was limp before and has not left its pose."""
        if self.mode not in (Mode.OFF, Mode.OFFLINE):
            self._switch_off()

    def lose_bus(self, error: YamError) -> None:
        """The channel is gone: nothing reaches the motors, whose own watchdogs now act. The arm is off for us."""
        logger.error("%s: %s", self.name, error)
        self.message = str(error)
        self.mode = Mode.OFF

    def fail(self, error: Exception) -> None:
        """Something in our own code broke: the last commands that went out hold the arm, at rest."""
        if self.mode is not Mode.FAULT:
            logger.critical("%s: internal error, holding", self.name, exc_info=error)
            self.message = f"internal error, holding: {error!r}"
            self.mode = Mode.FAULT
        self._landing = None
        self._commands[:] = self._sent
        self._commands[:, laws.DQ] = 0.0

    def send(self) -> None:
        """Put this tick's commands on the wire."""
        self.chain.send(self._packable())
        self._sent[:] = self._commands

    def _packable(self) -> np.ndarray:
        return self._quantiser.compensate(self._map.commands(self._commands))

    def collect(self, deadline_s: float) -> None:
        """Take the replies of this tick; whatever is missing at the deadline ages."""
        self.chain.collect(deadline_s)

    def measure(self, now: float) -> None:
        """From the replies to the state of the arm."""
        self._read()
        self._watch(now)

    def update(self, now: float, dt: float) -> None:
        """From the state to the next commands."""
        if self.mode is Mode.BRING_UP:
            self._bring_up(now)
        if self.mode is Mode.TRACK and now - self._last_target_at > self.config.command_timeout_s:
            self.limited |= Limited.COMMAND_TIMEOUT
            self.setpoint.stop()
            self._enter(Mode.HOLD)
        if self._landing is not None:
            self._advance_landing(now)
        self.setpoint.advance(now, dt)
        self._compute(now)

    def aim(
        self,
        target: np.ndarray,
        now: float,
        velocity: np.ndarray | None = None,
        kp: np.ndarray | None = None,
        kd: np.ndarray | None = None,
    ) -> bool:
        """A new target (n,), gripper 0 … 1; taken while holding or tracking only. True when taken."""
        if self.mode not in (Mode.HOLD, Mode.TRACK):
            return False
        self._last_target_at = now
        self.limited = Limited.NOTHING
        self.setpoint.aim(target, now, velocity)
        hw = self.hardware
        self._kp = hw.kp if kp is None else np.where(np.isnan(kp), hw.kp, kp)
        self._kd = hw.kd if kd is None else np.where(np.isnan(kd), hw.kd, kd)
        if self.mode is Mode.HOLD:
            self._enter(Mode.TRACK)
        return True

    def request(self, request: Request, now: float) -> None:
        """Change mode as the caller asks.

        Raises:
            LifeCycleError: not from the present mode.
        """
        if request is Request.LAND:
            self.land(now)
        elif request is Request.HOLD:
            if self.mode is not Mode.HOLD:
                check_transition(self.name, self.mode, Mode.HOLD)
                if self.mode is Mode.FLOAT:
                    self.setpoint.seed(self.q)
                self.setpoint.stop()
                self._enter(Mode.HOLD)
        elif request is Request.FLOAT:
            if self.mode is not Mode.FLOAT:
                self._enter(Mode.FLOAT)
        elif request is Request.CALIBRATE_GRIPPER:
            if self.gripper is None:
                raise MotorError(f"{self.name}: {self.hardware.gripper.name} has no motor to calibrate")
            before = self.mode
            self._enter(Mode.BRING_UP)
            self._after_search = before
            self.setpoint.stop()
            self.gripper.begin(calibrate=True)

    def land(self, now: float) -> None:
        """Begin to land; does nothing when landing or off already."""
        if self.mode in (Mode.LAND, Mode.OFF):
            return
        if self.mode is Mode.OFFLINE:
            self.mode = Mode.OFF
            return
        floating = self.mode is Mode.FLOAT
        self._enter(Mode.LAND)
        if self.gripper is not None:
            self.gripper.stop_search()
        self.message = ""
        self._kp, self._kd = self.hardware.kp, self.hardware.kd
        if floating:
            self.setpoint.seed(self.q)
        if self.hardware.joints:
            self._landing = Landing(self.name, self.hardware.rest_q, self.q[: self.hardware.joints], self.setpoint, now)
        else:
            self._switch_off()  # a gripper alone falls nowhere

    def _enter(self, mode: Mode) -> None:
        check_transition(self.name, self.mode, mode)
        self.mode = mode

    def _read(self) -> None:
        chain, hw = self.chain, self.hardware
        self._motor_q = self._map.position(chain.position_rad)
        self._motor_dq = chain.velocity_rad_s * hw.direction
        self.tau = chain.torque_nm * hw.direction
        self.q, self.dq = self._motor_q.copy(), self._motor_dq.copy()
        if self.gripper is not None:
            self.q[-1], self.dq[-1] = self.gripper.normalised(float(self._motor_q[-1]), float(self._motor_dq[-1]))

    def _watch(self, now: float) -> None:
        """A motor that is silent or not obeying is a fault: the others hold, the caller is told."""
        if self.mode in (Mode.OFF, Mode.OFFLINE):
            return
        bad, message = self._motor_watch.check(now)
        self._usable = ~bad
        if not message or self.mode in (Mode.FAULT, Mode.LAND):
            return
        self.message = message
        logger.error("%s (%s): motor fault, holding with the rest: %s", self.name, self.config.channel, self.message)
        if self.mode is Mode.FLOAT:
            self.setpoint.seed(self.q)
        self.setpoint.stop()
        if self.gripper is not None:
            self.gripper.stop_search()
        self._enter(Mode.FAULT)

    def _bring_up(self, now: float) -> None:
        """Leave bring-up once the gripper's stops are known."""
        if self.gripper is not None:
            if not self.gripper.searching:
                return
            try:
                shift = self.gripper.advance(now, float(self._motor_q[-1]))
            except YamError as error:
                self.message = str(error)
                logger.error("%s", error)
                self._enter(Mode.FAULT)
                return
            if shift is None:
                return
            self._map.shift(self.hardware.n - 1, shift)
            self._read()
            self.setpoint.reseed(self.hardware.n - 1, float(self.q[-1]))
        self._enter(self._after_search)

    def _advance_landing(self, now: float) -> None:
        assert self._landing is not None
        joints = self.hardware.joints
        before = self._landing.phase
        self._landing.advance(self.q[:joints], self.dq[:joints], self._usable[:joints], now)
        if self._landing.phase is Phase.OBSTRUCTED and before is not Phase.OBSTRUCTED:
            self.message = "landing is obstructed; holding"
        if self._landing.phase is Phase.LANDED:
            self._landing = None
            self._switch_off()
            logger.info("%s: landed, torque off", self.name)

    def _switch_off(self) -> None:
        """Cut torque. Only from a landed pose, or where the arm was limp a moment ago."""
        for _ in range(3):
            if all(self.chain.special(SpecialCommand.DISABLE, timeout_s=0.02)):
                break
        self.mode = Mode.OFF
        self._commands[:] = 0.0

    def _compute(self, now: float) -> None:
        """This tick's commands from set-point and state."""
        hw, out, joints = self.hardware, self._commands, self.hardware.joints
        q, dq = self._motor_q, self._motor_dq
        tau = np.zeros(hw.n)
        if self._gravity is not None:
            tau[:joints] = self._gravity.torque(q[:joints]) * hw.arm.gravity_factor
        if self.mode is Mode.FLOAT:
            tau[:joints] += laws.friction(dq[:joints], hw.coulomb_nm)
            laws.float_free(out, q, hw.idle_kd, tau)
        else:
            q_set, dq_set = self.setpoint.q.copy(), self.setpoint.dq.copy()
            tau[:joints] += laws.friction(dq_set[:joints], hw.coulomb_nm)
            laws.follow(out, q_set, dq_set, self._kp, self._kd, tau)
        if self._landing is not None and self._landing.phase is Phase.FADE:
            laws.fade(out, self._landing.share, np.full(hw.n, _LANDING_KD))
        if self.gripper is not None and self.mode is not Mode.FLOAT:
            u, u_rate = float(self.setpoint.q[-1]), float(self.setpoint.dq[-1])
            self.gripper.command(out[-1], now, u, u_rate, float(q[-1]), float(self.dq[-1]), float(self.tau[-1]))
            if self.gripper.force_limited:
                self.limited |= Limited.GRIPPER_FORCE
        if laws.clip_torque(out, q, dq, hw.torque_limit_nm):
            self.limited |= Limited.TORQUE
