"""Console that turns one motor by the arrow keys: the only action of yam-motors that energises a motor.

If this program is killed, the motor's watchdog switches the motor off after the motor's timeout.
"""

import argparse
import math
from dataclasses import dataclass

from lerobot_robot_yam.arm.joint_map import resolve_turn
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.commands.lib.arm_command import with_answering_gripper
from lerobot_robot_yam.commands.lib.dialogue import confirm_word, tell
from lerobot_robot_yam.commands.lib.key_terminal import DOWN, LEFT, QUIT, RIGHT, UP, KeyTerminal, key_terminal
from lerobot_robot_yam.commands.lib.motor.motor_bench import SAFE_COUNTS, MotorBench
from lerobot_robot_yam.control.preflight.arm_inspection import refuse_stopped
from lerobot_robot_yam.damiao.codec import SpecialCommand, encode_mit, ranges_of, unpack_feedback
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.damiao.settings.motor_memory import MotorState, read_state
from lerobot_robot_yam.damiao.tables import TIMEOUT_COUNT_S, ControlMode, Fault, fault_text, motor_type
from lerobot_robot_yam.errors import ConfigError, MotorError
from lerobot_robot_yam.mobile.base_profile import BaseProfile
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.system.signals import undisturbed

HELP = "left/right: target   up/down: step   k/K: kp   d/D: kd   space: stay here   q: let down and quit"
SPEED_RAD_S = 0.5  # speed limit of the set-point, rad/s
_STEPS = (0.01, 0.02, 0.05, 0.1, 0.2)  # steps by which an arrow key can move the target, rad
_GAIN_FACTOR = 1.25
_KP_RANGE, _KD_RANGE = (1.0, 100.0), (0.1, 5.0)
_TORQUE_SHARE = 0.3  # limit of the torque for the position error, as a share of the motor's maximum torque
_PERIOD_S = 0.01
_LONGEST_S = 0.03  # maximum time step of the set-point, s: the set-point must not jump after a delay
_SHOWN_S = 0.1
_SILENT_S = 0.2
_AT_REST_RAD = 0.15
_LET_DOWN_S, _LET_DOWN_KD, _DISABLES = 1.5, 5.0, 3


@dataclass
class Knob:
    """Target of one motor, in motor coordinates, moved by keys.

    tau = kp (q* − q) − kd dq. The set-point q* moves to the target at a limited speed, and stays so close to q that
    kp |q* − q| is within the torque limit.

    Args:
        kind: motor type.
        start_rad: angle of the motor at the start, rad; the target stays within `range_rad` of this angle.
        torque_nm: maximum torque for the position error, kp |q* − q|, Nm.
    """

    kind: str
    start_rad: float
    range_rad: float
    torque_nm: float
    kp: float = 10.0
    kd: float = 1.0

    def __post_init__(self) -> None:
        self.setpoint_rad = self.target = self.start_rad
        self._step = 2

    @property
    def step(self) -> float:
        """Step by which an arrow key moves the target, rad."""
        return _STEPS[self._step]

    def press(self, key: str) -> None:
        """Process one key; keys that are not in `HELP` are ignored."""
        if key in (LEFT, RIGHT):
            self._aim(self.target + (self.step if key == RIGHT else -self.step))
        elif key in (UP, DOWN):
            self._step = min(max(self._step + (1 if key == UP else -1), 0), len(_STEPS) - 1)
        elif key == " ":
            self.stay()
        elif key in ("k", "K"):
            self.kp = _turned(self.kp, key == "K", _KP_RANGE)
        elif key in ("d", "D"):
            self.kd = _turned(self.kd, key == "D", _KD_RANGE)

    def stay(self) -> None:
        """Set the target to the current set-point, which stops the motor."""
        self._aim(self.setpoint_rad)

    def command(self, q: float, elapsed_s: float) -> bytes:
        """Return the next MIT command, 8 bytes. `q`: motor angle, rad; `elapsed_s`: time since the last command, s."""
        way = SPEED_RAD_S * elapsed_s
        lead = self.torque_nm / self.kp
        moved = min(max(self.target, self.setpoint_rad - way), self.setpoint_rad + way)
        self.setpoint_rad = min(max(moved, q - lead), q + lead)
        return encode_mit(self.kind, self.setpoint_rad, 0.0, self.kp, self.kd, 0.0)

    def _aim(self, target: float) -> None:
        self.target = min(max(target, self.start_rad - self.range_rad), self.start_rad + self.range_rad)


def _turned(gain: float, up: bool, ends: tuple[float, float]) -> float:
    return min(max(gain * _GAIN_FACTOR if up else gain / _GAIN_FACTOR, ends[0]), ends[1])


def console(args: argparse.Namespace, bench: MotorBench) -> int:
    """Run `yam-motors console`: turn one motor by the arrow keys."""
    if not args.motor or len(args.motor) != 1:
        raise ConfigError("name one motor (--motor joint_6)")
    if not 0.0 < args.range <= math.pi:
        raise ConfigError(f"the motor may turn by 0 to {math.pi:.2f} rad from where it is, not by {args.range:g}")
    (can_id,) = bench.ids(args.motor)
    name = bench.name(can_id)
    refuse_stopped(name, EmergencyStop())
    others = [other for other in bench.names if other != can_id and bench.access.replies(other, Register.ESC_ID)]
    bench.require_settable([can_id, *others])
    contents = bench.contents(can_id)
    _require_watchdog(bench, name, contents.get(Register.TIMEOUT))
    kind = bench.kind(contents)
    if kind == BaseProfile().steer_type:
        raise ConfigError(f"{bench.channel}: {name} is a base's motor: it obeys velocities only")
    most_nm = _TORQUE_SHARE * motor_type(kind).torque_max_nm  # raises for an unknown type
    _confirm(args, bench, name)
    refuse_stopped(name, EmergencyStop())  # checked again: confirming may have taken long
    bench.require_settable([can_id, *others])
    state = read_state(bench.access, can_id)
    if state is None:
        raise MotorError(f"{bench.channel}: {name} gives no feedback; nothing was energised")
    motor = _Motor(bench, can_id, kind, int(contents[Register.MST_ID]))
    with key_terminal() as terminal:
        try:
            motor.enable()
            tell(HELP)
            _follow_keys(motor, Knob(kind, state.position_rad, args.range, most_nm), terminal)
        finally:
            with undisturbed("the joint is being let down"):
                motor.let_down()
    tell(f"\n{name} is limp")
    return 0


def _require_watchdog(bench: MotorBench, name: str, counts: float | None) -> None:
    """Check the timeout that stops the motor if this program dies. Raises MotorError: it is above 0.4 s, or unset."""
    if counts is None or not 0 < counts <= SAFE_COUNTS:
        lasts = f"for {counts * TIMEOUT_COUNT_S:g} s" if counts else "for ever"
        raise MotorError(
            f"{bench.channel}: {name} goes on {lasts} if this program dies; set its time-out first "
            f"(yam-motors timeout {bench.config.on_command_line} 0.4)"
        )


def _confirm(args: argparse.Namespace, bench: MotorBench, name: str) -> None:
    """Print which motor will be energised and which joints are off their rest pose, and ask for confirmation."""
    tell(
        f"HAZARD: this energises {name} alone; every other motor of the arm stays limp. When it ends, or is killed, "
        f"{name} goes limp, too. Keep hands off, and the switch of the supply within reach."
    )
    word = "enable"
    if off := _off_rest(args, bench):
        word = "in the air"
        tell(f"THE ARM HANGS IN THE AIR OR IS HELD UP: {off}. It falls when it is let go: support it all the time.")
    confirm_word(False, word, f"Type {word} to energise {name}:")


def _off_rest(args: argparse.Namespace, bench: MotorBench) -> str:
    """Return a text that lists the joints that are not at rest; empty if the arm lies in its rest pose."""
    hardware = ResolvedArm(with_answering_gripper(args, bench.bus))
    off = []
    for index, spec in enumerate(hardware.motors[: hardware.joints]):
        state = read_state(bench.access, spec.can_id)
        if state is None:
            off.append(f"{spec.name} does not answer")
            continue
        q = state.position_rad * hardware.direction[index]
        low, high = hardware.arm.joint_limits_rad[index]
        try:
            q += resolve_turn(bench.channel, spec.name, q, low, high)
        except MotorError:
            off.append(f"{spec.name} reads {q:+.2f} rad, outside its range")
            continue
        if abs(q - hardware.rest_q[index]) > _AT_REST_RAD:
            off.append(f"{spec.name} is {q - hardware.rest_q[index]:+.2f} rad from rest")
    return ", ".join(off)


class _Motor:
    """Motor that the console energises.

    Args:
        bench: access to the motor's bus.
        can_id, kind: id and type of the motor.
        answers: CAN identifier of the motor's feedback.
    """

    def __init__(self, bench: MotorBench, can_id: int, kind: str, answers: int):
        self._access, self._id, self._kind, self._answers = bench.access, can_id, kind, answers
        self.where = f"{bench.channel}: {bench.name(can_id)}"
        self.clock = bench.access.port.clock

    def enable(self) -> None:
        """Energise the motor. Raises MotorError: the motor does not accept the control mode."""
        self._access.write_and_check(self._id, Register.CTRL_MODE, ControlMode.MIT)
        self._access.special(self._id, SpecialCommand.ENABLE)

    def exchange(self, data: bytes) -> MotorState | None:
        """Send a command; return the motor's reply, or None if no reply arrived."""
        answer = self._access.exchange(self._id, self._answers, self._id, data, _PERIOD_S)
        return None if answer is None else MotorState(*unpack_feedback(ranges_of(self._kind), answer)[1:])

    def let_down(self) -> None:
        """Damp the motor for `_LET_DOWN_S`, then disable it. Raises MotorError: the motor may still be energised."""
        damping = encode_mit(self._kind, 0.0, 0.0, 0.0, _LET_DOWN_KD, 0.0)
        deadline = self.clock.now() + _LET_DOWN_S
        while self.clock.now() < deadline:
            state = self.exchange(damping)
            if state is not None and state.fault != Fault.NORMAL:
                break
            self.clock.sleep(_PERIOD_S)
        for _ in range(_DISABLES):
            self._access.special(self._id, SpecialCommand.DISABLE)
            state = read_state(self._access, self._id)
            if state is not None and state.fault != Fault.NORMAL:
                return
        raise MotorError(f"{self.where} MAY STILL BE ENERGISED: support the arm, and switch its power off")


def _follow_keys(motor: _Motor, knob: Knob, terminal: KeyTerminal) -> None:
    """Send the knob's commands to the motor until `q` is typed or the terminal is closed.

    Raises:
        MotorError: the motor has stopped replying, or reports a fault.
    """
    stop, q, stopped = EmergencyStop(), knob.start_rad, False
    heard_s = sent_s = motor.clock.now()
    shown_s = -math.inf
    while not terminal.gone:
        before, stopped = stopped, stop.latched
        for key in terminal.keys(_PERIOD_S):
            if key in QUIT:
                return
            if not stopped:
                knob.press(key)
        if stopped and not before:
            knob.stay()
        last_s, sent_s = sent_s, motor.clock.now()  # measured: fast typing shortens the period
        state = motor.exchange(knob.command(q, min(sent_s - last_s, _LONGEST_S)))
        now = motor.clock.now()
        if state is None:
            if now - heard_s > _SILENT_S:
                raise MotorError(f"{motor.where} has fallen silent; its time-out lets it go")
            continue
        q, heard_s = state.position_rad, now
        if state.fault != Fault.NORMAL:
            raise MotorError(f"{motor.where} has let go: {fault_text(state.fault)}")
        if now - shown_s > _SHOWN_S:
            shown_s = now
            tell(_line(knob, state, stopped), end="")


def _line(knob: Knob, state: MotorState, stopped: bool) -> str:
    gains = f"kp {knob.kp:.1f} kd {knob.kd:.2f}"
    measured = f"q {state.position_rad:+.3f} rad  dq {state.velocity_rad_s:+.2f}  tau {state.torque_nm:+.2f} Nm"
    heat = f"{state.temp_mos_c}/{state.temp_rotor_c} °C"
    end = "EMERGENCY STOP" if stopped else fault_text(state.fault)
    return f"\rtarget {knob.target:+.3f} rad step {knob.step:g}  {gains}  {measured}  {heat}  {end} "
