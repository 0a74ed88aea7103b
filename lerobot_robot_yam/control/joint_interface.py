"""Motors and teaching handle of one arm as joints: bring-up checks, commands out, positions in. No laws."""

import logging
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import can
import numpy as np

from lerobot_robot_yam.arm.joint_map import JointMap, resolve_turn
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.gripper.gripper import Gripper
from lerobot_robot_yam.control.gripper.handle_reader import HandleReader
from lerobot_robot_yam.control.gripper.trigger_range import TriggerRange, load_range
from lerobot_robot_yam.control.laws import mit_laws
from lerobot_robot_yam.control.preflight import arm_inspection
from lerobot_robot_yam.control.safety.channel_monitor import ChannelMonitor, Finding
from lerobot_robot_yam.control.safety.thermal_monitor import ThermalMonitor, trips_c
from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.handle_encoder import HandleEncoder
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.damiao.tables import Fault, motor_type
from lerobot_robot_yam.errors import MotorError, YamError
from lerobot_robot_yam.state.faults import SILENT_S

logger = logging.getLogger(__name__)

_ANSWER_S = 0.006  # motors answer within a few ms, and the other arm gets no commands until then
_ASK_AGAIN = 5  # a question or its answer may get lost
_ASK_MOST = 12  # the same, of one that was heard just now and is to be believed again
_ASK_AT_LEAST = 3  # before motors are believed again: an answer may be somebody else's,
_AGREE = 2  # or garbled; so many have to agree
_DOUBLED = 2  # and then there are more of them than questions; one may be a late one
_REARM_ATTEMPTS = 2  # 27 ms each for seven motors, and the loop must not seem to hang
_SWINGS_RAD_S = 1.0  # a joint without torque that hangs still is slower
_TOO_FAST_RAD_S = 10.0  # in such a swing it is not armed: to be held at once would be a blow
_SOON_S = 0.02  # where no loop waits
_OFF_S = 0.01  # and what its adapter takes, 40 ms at most; three times, and in between the other arm is commanded
_PUSHED_RAD = 0.5  # a hand or a load can push a joint this far from a set-point that it holds
_OFF_SHARE = 0.15  # of a motor's range, by which its torque may differ from what its command gives where it is


class JointInterface:
    """Motors of one channel in joint coordinates, n motors, the gripper's last.

    Args:
        hardware: the arm.
        bus: an open bus; not closed here.

    Attributes:
        q, dq, tau: (n,) rad, rad/s, Nm; the gripper's q is 0 closed … 1 open, its dq strokes/s.
        motor_q, motor_dq: the same, the gripper's in rad and rad/s.
        handle: the teaching handle, None without one.
        before: q and dq as those, of each motor's sample before; NaN before there is one.
        on_wait: called between questions that a running loop waits for, so that it may hold the other arms.
    """

    def __init__(self, hardware: ResolvedArm, bus: can.BusABC):
        self._hardware, self._bus = hardware, bus
        self._config = config = hardware.config
        hw, n = hardware, hardware.n
        self._encoder = HandleEncoder() if hw.gripper.handle_encoder else None
        self.chain = MotorChain(bus, hw.motors, channel=config.channel, encoder=self._encoder)
        self.gripper = None
        if hw.has_gripper:
            self.gripper = Gripper(config, hw.gripper, float(hw.kp[-1]), float(hw.kd[-1]))
        self._map = JointMap(hw.direction, np.zeros(n))
        self._watch = ChannelMonitor(self.chain)
        self.heat: ThermalMonitor | None = None  # known after `inspect`
        self.q, self.dq, self.tau = np.zeros(n), np.zeros(n), np.zeros(n)
        self.motor_q, self.motor_dq = np.zeros(n), np.zeros(n)
        self.before = np.full(n, np.nan), np.full(n, np.nan)
        self.sent = np.zeros((n, 5))  # in joint coordinates
        self.on_wait: Callable[[], None] = lambda: None
        self.handle: HandleReader | None = None
        if self._encoder is not None:
            self.handle = HandleReader(config.name, self._encoder, _trigger_range(hw))

    @property
    def offset_rad(self) -> np.ndarray:
        """(n,) motor angle at joint zero."""
        return self._map.offset_rad

    def inspect(self) -> None:
        """Check that everything is there and as configured. Sends no command that moves or energises anything.

        Raises:
            YamError: names the part that is not.
        """
        arm_inspection.inspect(self._hardware, self.chain, self._bus)
        self.read()
        self._resolve(range(self._hardware.joints))
        if self.gripper is not None:
            (self.gripper.begin if self._config.gripper_search else self.gripper.begin_if_known)()
        self.read()
        ot_value_c = [self.chain.read_register(i, Register.OT_VALUE) for i in range(len(self.chain))]
        self.heat = ThermalMonitor(self._config.name, *trips_c(ot_value_c), [m.name for m in self.chain.motors])
        arm_inspection.clear_stale_faults(self._config.name, self.chain)

    def adopt(self, record: np.ndarray) -> None:
        """Know what a loop that has died knew; `record` is the state that it has published last."""
        slots = self._hardware.slots
        self._map.offset_rad[:] = np.nan_to_num(record["offset_rad"][slots])
        motor_q, motor_dq = np.nan_to_num(record["q"][slots]), np.nan_to_num(record["dq"][slots])
        if self.gripper is not None:
            self.gripper.adopt(*record["gripper_stops_rad"].tolist())
            if self.gripper.stops is not None:
                motor_q[-1] = self.gripper.stops.motor(float(motor_q[-1]))
                motor_dq[-1] *= self.gripper.stops.span_rad
        direction = self._hardware.direction
        assumed_rad = self._map.motor(motor_q)
        self.chain.feedback.assume(assumed_rad, motor_dq * direction, record["motor_stamp_s"][slots])
        self.chain.feedback.distrust(np.flatnonzero(record["distrusted"][slots]).tolist(), assumed_rad)
        for _ in range(3):
            if all(self.chain.refresh(timeout_s=0.01)):
                break
        self.read()

    def enable(self, on_wait: Callable[[], None] = lambda: None) -> None:
        """Enable all motors, and hear where they are by now; they wait for a command, without torque.

        Args:
            on_wait: called between questions.

        Raises:
            MotorError: one does not answer.
        """
        self.chain.feedback.believe(range(len(self.chain)))
        silent = [self.chain.motors[i] for i in self._enable(range(len(self.chain)), _SOON_S, _ASK_AGAIN, on_wait)]
        self.read()
        if silent:
            names = ", ".join(f"{motor.name} (id {motor.can_id})" for motor in silent)
            raise MotorError(
                f"{self._config.name} ({self._config.channel}): cannot enable {names}: no answer; check power and cable"
            )

    def _enable(
        self, motors: Iterable[int], timeout_s: float, attempts: int, on_wait: Callable[[], None] = lambda: None
    ) -> list[int]:
        """ENABLE, again where it or its answer has got lost; returns the motors that have not answered."""
        off, silent = list(motors), []
        for _ in range(attempts):
            answered = self.chain.special(SpecialCommand.ENABLE, timeout_s, off)
            silent = [i for i in off if not answered[i]]
            off = [i for i in off if not answered[i] or self.chain.fault[i] == Fault.DISABLED]
            if not off:
                break
            on_wait()
        return silent

    def clear_and_enable(self, motors: Sequence[int]) -> list[int]:
        """Believe these motors again, clear the faults of those that have one, and enable them: without torque.

        Nothing is sent to a silent motor: it may still hold its joint. Returns those that had let go.

        Raises:
            MotorError: one is where its joint cannot be, contradicts itself, moves too fast to be armed, or two answer
                for it. Those that were enabled are disabled again; one that had kept its torque keeps it, and is not
                believed.
        """
        chain, believed_rad, distrusted = self.chain, self.chain.position_rad, self.chain.distrusted
        believed_rad_s, limp = chain.velocity_rad_s, chain.fault != Fault.NORMAL
        with chain.in_haste():
            chain.feedback.restart(motors)
            doubled, lost, rejected = chain.duplicates, chain.lost, chain.feedback.rejected
            stamp_s, answers = chain.stamp_s, np.zeros_like(chain.stamp_s)
            fastest_rad_s = np.zeros_like(chain.stamp_s)  # of what they say now
            for count in range(_ASK_MOST):
                silent = chain.silence_s(chain.clock.now())[motors] >= SILENT_S
                if count >= _ASK_AT_LEAST and (silent | (answers[motors] >= _AGREE)).all():
                    break
                chain.refresh(_ANSWER_S)
                news = chain.stamp_s > stamp_s
                answers, stamp_s = answers + news, chain.stamp_s
                fastest_rad_s = np.where(news, np.maximum(fastest_rad_s, np.abs(chain.velocity_rad_s)), fastest_rad_s)
                self.on_wait()
            if (chain.duplicates - doubled - (chain.lost - lost) >= _DOUBLED).any():  # which is ours, nobody knows
                self.disbelieve(motors, believed_rad)
                raise MotorError(
                    f"{self._config.name} ({self._config.channel}): motors answer twice; look for a second arm on the "
                    "channel"
                )
            silence_s = chain.silence_s(chain.clock.now())
            heard = [i for i in motors if silence_s[i] < SILENT_S]
            self.disbelieve([i for i in motors if i not in heard and distrusted[i]], believed_rad)
            too_fast = fastest_rad_s > _TOO_FAST_RAD_S
            too_fast[self._hardware.joints :] = False  # a gripper weighs next to nothing
            # Not even that a motor has let go is believed of one answer. To clear its fault would cut its torque.
            garbled = (answers < _AGREE) | (chain.feedback.rejected > rejected)
            refused = [i for i in heard if too_fast[i] or garbled[i]]
            if refused:
                self.disbelieve(motors, believed_rad)
                swings_rad_s = np.maximum(np.abs(believed_rad_s), fastest_rad_s)
                raise self._refusal(refused, np.where(limp | too_fast, swings_rad_s, 0.0))
            off = [i for i in heard if chain.fault[i] != Fault.NORMAL]
            chain.special(SpecialCommand.CLEAR, _ANSWER_S, off)
            self.on_wait()
            self._enable(off, _ANSWER_S, _REARM_ATTEMPTS, self.on_wait)
            self.read()
            try:
                self._resolve([i for i in off if i < self._hardware.joints])  # without power it forgets its turn
                self._compare([i for i in heard if i not in off], believed_rad)  # with power it does not
            except YamError:
                chain.special(SpecialCommand.DISABLE, _ANSWER_S, off)
                self.disbelieve([i for i in heard if i not in off], believed_rad)
                raise
            self.read()
            return off

    def _refusal(self, refused: Sequence[int], swings_rad_s: np.ndarray) -> MotorError:
        """Of motors that swing, or whose answers do not fit each other, as of one that swings and meets its stop.

        swings_rad_s: (n,) speed of those without torque, else 0.
        """
        told = {i: f"{self.chain.motors[i].name} (id {self.chain.motors[i].can_id})" for i in refused}
        swinging = [i for i in refused if i < self._hardware.joints and swings_rad_s[i] > _SWINGS_RAD_S]
        if swinging:
            what = ", ".join(f"{told[i]} still swings, at {swings_rad_s[i]:.0f} rad/s" for i in swinging)
            remedy = "wait until it hangs still, and re-arm again; if it does, check cable, plugs and termination"
        else:
            what = f"the answers of {', '.join(told.values())} contradict each other, or come too seldom"
            remedy = "check cable, plugs and termination, and re-arm again"
        return MotorError(f"{self._config.name} ({self._config.channel}): {what}; {remedy}")

    def _compare(self, motors: Sequence[int], believed_rad: np.ndarray) -> None:
        """
        Raises:
            MotorError: some say to be where they cannot have got from where they were sent last, and from where they
                were believed, `believed_rad`, (n,) motor coordinates. Or they work with another torque than their last
                command gives there, kp (q* − q) + kd (dq* − dq) + tau: a joint that was pushed away pulls back.
        """
        sent = self.sent
        low = high = sent[:, mit_laws.Q]
        if self.gripper is not None:  # what it presses on may have kept it from where it was sent
            low, high, believed = low.copy(), high.copy(), float(self._map.position(believed_rad)[-1])
            low[-1], high[-1] = min(low[-1], believed), max(high[-1], believed)
        gap = np.maximum(low - self.motor_q, self.motor_q - high)
        range_nm = np.array([motor_type(motor.type).torque_max_nm for motor in self._hardware.motors])
        spring_nm = sent[:, mit_laws.KP] * (sent[:, mit_laws.Q] - self.motor_q)
        damping_nm = sent[:, mit_laws.KD] * (sent[:, mit_laws.DQ] - self.motor_dq)
        gives_nm = np.clip(spring_nm + damping_nm + sent[:, mit_laws.TAU], -range_nm, range_nm)
        off = (gap > _PUSHED_RAD) | (np.abs(gives_nm - self.tau) > _OFF_SHARE * range_nm)
        lying = [index for index in motors if off[index]]
        if not lying:
            return
        told = "; ".join(
            f"{self._hardware.motors[index].name} (id {self._hardware.motors[index].can_id}) still reads "
            f"{self.motor_q[index]:.2f} rad and was sent to {sent[index, mit_laws.Q]:.2f}, and works with "
            f"{self.tau[index]:.1f} Nm where its command gives {gives_nm[index]:.1f}"
            for index in lying
        )
        raise MotorError(
            f"{self._config.name} ({self._config.channel}): {told}; check cables and plugs, let the arm land, and "
            "connect again"
        )

    def disbelieve(self, motors: Sequence[int], believed_rad: np.ndarray) -> None:
        """Take these motors to be where they were believed before, (n,) motor coordinates, whatever they say."""
        self.chain.feedback.distrust(motors, believed_rad)
        self.read()

    def disable(self) -> list[str]:
        """Cut torque. Returns the motors that have not confirmed it."""
        with self.chain.in_haste():
            for _ in range(3):
                self.chain.special(SpecialCommand.DISABLE, _OFF_S)
                self.on_wait()
                if (self.chain.fault != Fault.NORMAL).all():
                    break
        return [self.chain.motors[i].name for i in np.flatnonzero(self.chain.fault == Fault.NORMAL)]

    def send(self, commands: np.ndarray) -> None:
        """Put commands (n, 5) on the wire.

        Raises:
            BusError: the channel does not take them.
            ActionError: they are not finite.
        """
        self.chain.send(self._map.commands(commands))
        self.sent[:] = commands

    def check(self, now: float) -> Finding:
        """Which motors cannot be relied on."""
        return self._watch.check(now)

    def exchange(self, commands: np.ndarray) -> Finding:
        """One tick on its own: send, wait, collect, check."""
        self.send(commands)
        clock = self.chain.clock
        clock.sleep(self.chain.expected_wire_s)
        self.chain.collect(clock.now() + 0.002)
        return self.check(clock.now())

    def shift_gripper(self, shift_rad: float) -> None:
        """Put the gripper's reading on the turn of its stops."""
        self._map.shift(self._hardware.n - 1, shift_rad)
        self.read()

    def read(self) -> None:
        """From the newest replies to joint coordinates."""
        chain, direction = self.chain, self._hardware.direction
        self.motor_q = self._map.position(chain.position_rad)
        self.motor_dq = chain.velocity_rad_s * direction
        self.before = self._map.position(chain.before_rad), chain.before_rad_s * direction
        self.tau = chain.torque_nm * direction
        self.q, self.dq = self.motor_q.copy(), self.motor_dq.copy()
        if self.gripper is not None:
            self.q[-1], self.dq[-1] = self.gripper.normalised(float(self.motor_q[-1]), float(self.motor_dq[-1]))

    def _resolve(self, joints: Sequence[int]) -> None:
        arm = self._hardware.arm
        for index in joints:
            low, high = arm.joint_limits_rad[index]
            angle = float(self.motor_q[index])
            name, place = arm.motors[index].name, self._config.on_command_line
            self._map.shift(index, resolve_turn(self._config.name, name, angle, low, high, place))


def _trigger_range(hardware: ResolvedArm) -> TriggerRange:
    """Of the arm's handle; the nominal one where a calibration may follow.

    Raises:
        GripperError: the file that keeps it is damaged.
    """
    config = hardware.config
    if config.calibration_path is None or not config.gripper_search:
        return TriggerRange()
    return load_range(config.name, Path(config.calibration_path), hardware.gripper.name)
